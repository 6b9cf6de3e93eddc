"""The pages of scripts/freiburg_table.py: tables to be read, and what the numbers say in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from rbtm_bench.report import render, with_intervals
from rbtm_bench.studies.freiburg.numbers import CONTROL_WAYS
from rbtm_bench.studies.freiburg.plan import (
    LOGS,
    NOTHING,
    OF_SYSTEM,
    SLOW,
    SYSTEM,
    WAYS,
    WINDOW,
    FreiburgSize,
)

MARKS = {"better": " (+)", "worse": " (-)", "": ""}
CONTROL_WORDS = {
    NOTHING: "no registration (odometry)",
    "previous": "previous scan",
    "keyframe": "last keyframe",
    "fixed_gap": "fixed gap",
}


@dataclass(frozen=True)
class FreiburgTables:
    """All numbers: see ``freiburg_numbers``."""

    table: pd.DataFrame
    differences: pd.DataFrame
    pooled: pd.DataFrame
    transfer: pd.DataFrame


def readme(
    results: FreiburgTables,
    size: FreiburgSize,
    command: str,
    versions: Mapping[str, str | None],
    times: bool = True,
) -> str:
    """The page: what was compared, what came of it, the whole table (with or without times), and
    how it was made."""
    parts = [
        "# The Freiburg logs: which model scan?",
        *_setup(size),
        "## Medians over backends",
        *medians(results.table),
        "## RBTM against each control",
        *comparison(results),
        "## By backend",
        _legend(),
        *_by_backend(results.differences),
        "## What choosing elsewhere costs",
        *_transfer(results.transfer),
        "## All rows",
        *_about_rows(results.table, times),
        markdown(results.table, times),
        "## What this does not show",
        *_limits(),
        f"Made by `{command}`. {_versions(versions)}",
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _versions(versions: Mapping[str, str | None]) -> str:
    known = [f"{name} {number}" for name, number in versions.items() if number]
    return f"Versions: {', '.join(known)}."


def _setup(size: FreiburgSize) -> list[str]:
    tries = [
        f"- `{way.selector}`: {way.knob} {', '.join(f'{v:g}' for v in way.values)}" for way in WAYS
    ]
    tries[-1] += f"; window {WINDOW}, so that it reaches as far back as the largest fixed gap"
    tries.append(
        f"- `{SYSTEM}` (KISS-ICP's whole odometry, with its own map): {OF_SYSTEM.knob} "
        f"{', '.join(f'{v:g}' for v in OF_SYSTEM.values)}"
    )
    scans = f", the first {size.max_scans} scans of each," if size.max_scans else ""
    lines = [
        f"Raw logs {', '.join(LOGS.values())}{scans} with the relations of Kuemmerle et al. 2009. "
        "The error is their mean absolute translation error (m); local: ends at most 30 s apart, "
        "long: further, which carry nearly all of the mean. The initial guess is wheel odometry "
        "between the two scans, the target a single scan, nothing is checked after registration, "
        "all else are the defaults (correspondence distance 0.3 m, circular descriptor). "
        "`none`: wheel odometry alone.",
        "Every way has four tries:\n\n" + "\n".join(tries),
        "**The setting of a row was chosen on the other two logs**: the least mean logarithm of "
        "their mean relation errors (docs/statistics.md).",
    ]
    if size.left_out:
        names = [f"{name} ({SLOW[name]})" if name in SLOW else name for name in size.left_out]
        lines.append(f"Left out: {', '.join(names)}.")
    return lines


def medians(table: pd.DataFrame) -> list[str]:
    """The errors of each way as medians over backends, and why local errors differ as they do."""
    rows = []
    for way, group in table.groupby("way", sort=False):
        row: dict[str, object] = {"way": way, "backends": group["backend"].nunique()}
        for log in LOGS.values():
            numbers = group[group["log"] == log][["mean_m", "local_m", "long_m"]].median()
            words = ["" if math.isnan(x) else render.three_digits(x) for x in numbers]
            row[f"{log}: mean (local, long) m"] = f"{words[0]} ({words[1]}, {words[2]})"
        rows.append(row)
    ways = {way: group["local_m"].median() for way, group in table.groupby("way")}
    lines = [render.render(pd.DataFrame(rows), "md")]
    if not any(math.isnan(ways.get(w, math.nan)) for w in ("previous", "fixed_gap", "rbtm")):
        previous, gap, rbtm = (
            render.three_digits(ways[way]) for way in ("previous", "fixed_gap", "rbtm")
        )
        lines.append(
            f"Local errors (medians over logs and backends: previous {previous} m, RBTM {rbtm} m, "
            f"fixed gap {gap} m) tell how far apart neighbouring scans are put. A fixed gap of g "
            "makes g chains that never meet again after the first scans: neighbours drift apart, "
            "whatever the registrations are worth, so on a log this control is weak. RBTM's chains "
            "meet where scans share a model scan; the previous scan and a keyframe keep neighbours "
            "together."
        )
    return lines


def comparison(results: FreiburgTables) -> list[str]:
    """How often RBTM is better than each control, and by how much over all backends."""
    lines = []
    whole = results.differences[results.differences["relations"] == "all"]
    for control in CONTROL_WAYS:
        rows = whole[(whole["control"] == control) & whole["ratio"].notna()]
        if rows.empty:
            continue
        better, worse = ((rows["verdict"] == v).sum() for v in ("better", "worse"))
        rest = len(rows) - better - worse
        lines.append(
            f"- **{CONTROL_WORDS[control]}**: of {len(rows)} pairs of log and backend RBTM is "
            f"better on {better}, worse on {worse}, not told apart on {rest}. "
            f"{_over_backends(results.pooled, control)}"
        )
    counted = whole[whole["ratio"].notna()]
    tests = int(counted["low"].notna().sum())
    return [
        "\n".join(lines),
        f"Better and worse: where the 95% interval of the paired difference of the mean relation "
        f"error excludes 0, resampled by place-time cluster. {tests} intervals are read here, none "
        "is adjusted for that, and such intervals are too short (80 to 87% hold the truth, "
        "docs/statistics.md): of single ones expect one in six to exclude 0 by chance. Three "
        "logs are three data sets: too few for a test over logs.",
        _sentence(whole),
        *_kinds(results.pooled),
    ]


def _over_backends(pooled: pd.DataFrame, control: str, relations: str = "all") -> str:
    """The ratios over all backends, log by log."""
    rows = pooled[(pooled["control"] == control) & (pooled["relations"] == relations)]
    parts = [
        f"{row.log} {_interval(row.ratio, row.low, row.high)}{MARKS[row.verdict]}"
        for row in rows.itertuples()
        if not math.isnan(row.ratio)
    ]
    return f"Error of RBTM over the control's, geometric mean over backends: {'; '.join(parts)}."


def _interval(value: float, low: float, high: float) -> str:
    words = render.three_digits(value)
    if math.isnan(low):
        return words
    return f"{words} [{render.three_digits(low)}, {render.three_digits(high)}]"


def _sentence(whole: pd.DataFrame) -> str:
    """On how many backends RBTM is better, or worse, than a control on every log."""
    parts = []
    for control in CONTROL_WAYS:
        verdicts = whole[whole["control"] == control].groupby("backend")["verdict"]
        always = verdicts.agg(lambda v: (v == "better").all() - int((v == "worse").all()))
        better, worse = list(always.index[always > 0]), list(always.index[always < 0])
        if better:
            parts.append(f"better than {CONTROL_WORDS[control]}: {', '.join(better)}")
        if worse:
            parts.append(f"worse than {CONTROL_WORDS[control]}: {', '.join(worse)}")
    if not parts:
        return "On all three logs alike RBTM is better, or worse, than a control with no backend."
    return f"On all three logs alike RBTM is {'; '.join(parts)}."


def _kinds(pooled: pd.DataFrame) -> list[str]:
    """The same over the local and the long relations apart."""
    lines = []
    for which in ("local", "long"):
        for control in CONTROL_WAYS:
            rows = pooled[(pooled["control"] == control) & (pooled["relations"] == which)]
            if rows["ratio"].notna().any():
                words = _over_backends(pooled, control, which).partition(": ")[2]
                lines.append(f"| {which} | {CONTROL_WORDS[control]} | {words.rstrip('.')} |")
    head = "| relations | control | error of RBTM over the control's, over all backends |"
    return ["\n".join([head, "|---|---|---|", *lines])] if lines else []


def _legend() -> str:
    return (
        "RBTM's mean relation error over the control's on all relations; (+): RBTM better, (-): "
        "worse, where the interval of the paired difference excludes 0; nothing behind: not told "
        "apart. Empty: one of the two failed."
    )


def _by_backend(differences: pd.DataFrame) -> list[str]:
    blocks = []
    whole = differences[differences["relations"] == "all"]
    for log in LOGS.values():
        rows = []
        for backend, group in whole[whole["log"] == log].groupby("backend", sort=False):
            by_control = {row.control: row for row in group.itertuples()}
            rows.append([str(backend), *(_cell(by_control[control]) for control in CONTROL_WAYS)])
        heads = [f"{log}: RBTM with", *(f"over {CONTROL_WORDS[c]}" for c in CONTROL_WAYS)]
        blocks.append(render.render(pd.DataFrame(rows, columns=heads), "md"))
    return blocks


def _cell(row: object) -> str:
    ratio, verdict = row.ratio, row.verdict  # type: ignore[attr-defined]
    return "" if math.isnan(ratio) else render.three_digits(ratio) + MARKS[verdict]


def _transfer(transfer: pd.DataFrame) -> list[str]:
    """How well the settings of each way carry over to another log."""
    if transfer.empty:
        return []
    wide = transfer.pivot(index="way", columns="log", values="times")
    wide = wide.reindex(index=transfer["way"].unique(), columns=transfer["log"].unique())
    rows = wide.map(lambda x: "" if math.isnan(x) else render.three_digits(x)).reset_index()
    worst = transfer.loc[transfer["times"].idxmax()]
    return [
        "Mean relation error with the setting chosen on the other logs over that of the best try "
        "on the log itself, geometric mean over backends. 1 would be a choice that could not be "
        "better; the best try is lucky as well as good.",
        render.render(rows, "md"),
        f"The settings of `{worst['way']}` carry over worst, to {worst['log']}: "
        f"{render.three_digits(worst['times'])} times the error of its best try there. Gaps and "
        "windows are counted in scans, and the robots move differently far between two.",
    ]


def _about_rows(table: pd.DataFrame, times: bool) -> list[str]:
    lines = [
        "Mean [95% interval over place-time clusters] (clusters). equal: settings among those "
        "tried with the very same score on the other logs."
    ]
    if times:
        lines[0] += (
            " ms: time a scan of one core, as if nothing had been shared; other work may have run "
            "on the machine, so read it as a ratio. table.csv has every digit, and the rotation of "
            "local and long relations."
        )
    failed = table[table["status"] != "done"]
    if len(failed):
        names = [f"{r.log} {r.backend} {r.way} ({r.reason})" for r in failed.itertuples()]
        lines.append(f"Failed: {'; '.join(names)}.")
    return lines


SHOWN = {
    "mean_m": "mean m",
    "local_m": "local m",
    "long_m": "long m",
    "mean_deg": "mean deg",
}


def markdown(table: pd.DataFrame, times: bool = True) -> str:
    """The table with its intervals folded in, as Markdown."""
    folded = with_intervals.folded(table)
    folded["tried"] = [f"{r.tried}, {r.equal} equal" if r.equal > 1 else r.tried for r in
                      folded.itertuples()]  # fmt: skip
    folded["coverage"] = folded["coverage"].astype(float).round(3)
    folded["ms"] = folded["ms_per_scan"].astype(float).round(2)
    names = ["log", "backend", "way", "setting", "tried", "chosen_on", "status", *SHOWN]
    names += ["coverage", "mean_gap", *(["ms"] if times else [])]
    return render.render(folded[names].rename(columns=SHOWN), "md")


def _limits() -> list[str]:
    return [
        "- Three logs of planar lasers indoors, one guess, one kind of target, no check and no "
        "loop closure: the numbers are not those of a SLAM system.\n"
        f"- RBTM chose a threshold only; its window ({WINDOW}) and descriptor were set beforehand, "
        "as were the angle of a keyframe and everything of the backends.\n"
        "- Two logs choose for the third: with so few a choice is unsure, for all ways alike.\n"
        "- Which gap a way takes is part of what is compared here. Whether similarity chooses "
        "better than chance at the same gaps is another question (the control random_gap)."
    ]


def final_lines(results: FreiburgTables) -> Sequence[str]:
    """What is printed last: the counts, a line a control."""
    return comparison(results)[0].replace("**", "").splitlines()
