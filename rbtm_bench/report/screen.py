"""The one screen at the end of a run or a comparison, and the tables that go with it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rbtm_bench.core.columns import COLUMNS
from rbtm_bench.core.files import write_text
from rbtm_bench.report import answer, best_settings, frame, render, verdict
from rbtm_bench.report.frame import MethodRuns
from rbtm_bench.report.replicates import OF_MAIN, data_set, number_of, spread
from rbtm_bench.runs import stored
from rbtm_bench.runs.stored import Run

if TYPE_CHECKING:
    import pandas as pd

LONG = 30
"""Rows of a table from which on it is written, not printed."""
NAMED = 2
"""Runs or folders that a line names at most."""
SPANNING = 4
"""Replicates from which on a run outside their range is worth a line."""
REASONS = 5
"""Reasons of failure that are listed at most."""

CONTROLS = (
    "+: a control that was not asked for (controls=none: without); keyframe and fixed_gap matched "
    "to\n  how far the best rbtm reaches, shifted_gap its gaps at other times: their median"
)
"""What the mark means."""

LINES = tuple(sorted((c for c in COLUMNS if c.line), key=lambda c: c.plain_unit in ("", "scans")))
"""The numbers in the summary of a run: errors and time, then shares and counts."""


def of_run(out: Path) -> str:
    """A run's main numbers and where its files are."""
    run = stored.read_run(out)
    row = frame.row(run)
    head = f"{row['dataset']}, {row['backend']}, {row['selector']}"
    lines = [f"{head}: {row['scans']} scans in {row['seconds']:.1f} s", *key_numbers(row)]
    determined = run.record.get("determined") or ()
    read = run.record.get("readings") or []
    lines += [f"  {line}" for line in read if line.startswith(tuple(determined))]
    lines += [words] if (words := answer.dead_words(run)) else []
    if run.record.get("skipped_records"):
        lines.append(f"  {run.record['skipped_records']} malformed records were skipped")
    lines.append(f"results in {out}   (figures: rbtm-bench plot {out})")
    lines += ["", *answer.answer(frame.methods([run]), str(out))]
    return "\n".join(lines)


def key_numbers(row: dict[str, Any]) -> list[str]:
    """A line for each of a run's main numbers."""
    lines = []
    for column in LINES:
        value = row.get(column.name)
        if value is not None:
            number = f"{value:.4g}" if isinstance(value, float) else str(value)
            lines.append(f"  {column.line:<30} {number:>10} {column.plain_unit}".rstrip())
    return lines


@dataclass(frozen=True, eq=False)
class RunTables:
    """The runs of a comparison or sweep, a table of a row a run, and one of a row a method."""

    runs: list[Run]
    every: pd.DataFrame
    methods: pd.DataFrame
    of_methods: list[MethodRuns]
    """The runs behind the rows of ``methods``, in the same order."""


def tables_of(folders: Sequence[Path]) -> RunTables:
    """The tables of the runs in these folders."""
    runs = stored.find_runs(folders)
    of_methods = frame.methods(runs)
    return RunTables(runs, frame.frame(runs), frame.table_of(of_methods), of_methods)


def write_tables(out: Path, tables: RunTables) -> None:
    """Write ``table.csv`` (a row a run) and ``summary.csv`` (a row a method)."""
    write_text(out / "table.csv", render.render(tables.every, "csv") + "\n")
    write_text(out / "summary.csv", render.render(tables.methods, "csv") + "\n")


def of_runs(out: Path, tables: RunTables) -> str:
    """The tables of a comparison or sweep, the verdict in words, the share of registrations
    reused, failures by reason, and where the files of ``write_tables`` are."""
    runs, methods = tables.runs, tables.methods
    best = best_settings.best(methods)
    has_tries = bool(best_settings.chances(best))
    lines = overview(methods, best)
    lines += verdict.verdict(methods, tables.of_methods, say_tries=not has_tries)
    lines += replicates_outside(tables.of_methods)
    lines += [*reuse(runs), *reasons(runs)]
    lines += [f"warning: {line}" for line in comparison_warnings(runs)]
    lines.append(f"a row a run: {out / 'table.csv'}; a row a method: {out / 'summary.csv'}")
    lines.append(f"figures: rbtm-bench plot {out}")
    lines += ["", *answer.answer(tables.of_methods, str(out))]
    return "\n".join(lines)


def overview(methods: pd.DataFrame, best: pd.DataFrame) -> list[str]:
    """The best setting of every method, and all methods if they fit a screen: one table where
    both would be the same."""
    if len(best) == len(methods) <= LONG:
        return with_same(methods, render.SHORT, render.ALWAYS)
    lines = of_best(best)
    if len(methods) > LONG:
        return [*lines, f"the table of all {len(methods)} methods is not printed, only written"]
    return [*lines, "", "all:", *with_same(methods, render.SHORT, render.ALWAYS)]


def of_best(best: pd.DataFrame) -> list[str]:
    """A table of best settings and its notes."""
    columns, main = best_settings.best_columns(best)
    names = [f"{name} ({unit})" for key, unit, name in best_settings.ERRORS if key in main]
    order = f", by {' or '.join(names)}" if names else ""
    table = with_same(best, columns, (*render.ALWAYS, *main))
    return [f"the best setting of every method{order}:", *table, *best_settings.chances(best)]


def with_same(table: pd.DataFrame, columns: Sequence[str], keep: Sequence[str]) -> list[str]:
    """A table as text, what is the same in every row, and what its numbers are."""
    table = best_settings.ranked(table)
    keep = (*keep, *best_settings.main_errors(table))
    table, columns, keep = _with_spread(table, [render.WINNER, *columns], keep)
    shown, same = render.screen_table(table, columns, keep)
    keep = (*keep, "status") if "status" in shown and table["status"].nunique() > 1 else keep
    lines = render.fitted(shown, (*keep, *frame.METHOD))  # what tells the rows apart stays
    notes = [f"the same in every row: {same}"] if same else []
    seeds = int(table["seeds"].max()) if table["seeds"].notna().any() else 1
    if shown.get("unperturbed") is not None and shown["unperturbed"].notna().any():
        notes.append(
            "medians over distinct replicates (perturbed copies of the data); beside the main "
            "error its quartiles, the worst, and the run on the data as they are"
        )
    elif seeds > 1:
        notes.append(f"medians over the runs of a method that differ only in their seed ({seeds})")
    if "control" in table and table["control"].notna().any():
        notes.append(CONTROLS)
    return [*lines, *render.in_width(notes)]


def _with_spread(
    table: pd.DataFrame, columns: Sequence[str], keep: Sequence[str]
) -> tuple[pd.DataFrame, Sequence[str], Sequence[str]]:
    """The table, and the names of its columns, with what stands behind the main error of methods
    with replicates: narrow enough for a screen."""
    spread_of = {key: f"{key}_q1" for key, _, _ in best_settings.ERRORS if f"{key}_q1" in table}
    main = [key for key in spread_of if key in columns and table[spread_of[key]].notna().any()]
    if not main:
        return table, columns, keep
    rows: list[dict[str, Any]] = []
    for _, row in table.iterrows():
        key = next((k for k in main if not render.is_empty(row[f"{k}_q1"])), None)
        cells = {} if key is None else {end: row[f"{key}_{end}"] for end in OF_MAIN}
        quartiles = [render.three_digits(cells[end]) for end in ("q1", "q3") if end in cells]
        rows.append({"quartiles": " - ".join(quartiles), **cells})
    beside = ["quartiles", "worst", "unperturbed"]
    table = table.assign(**{name: [row.get(name) for row in rows] for name in beside})
    at = list(columns).index(main[0]) + 1
    copied = "replicates" in table and table["replicates"].notna().any()  # else: rotations alone
    return table, [*columns[:at], *beside, *columns[at:]], (*keep, *(beside if copied else ()))


def replicates_outside(methods: Sequence[MethodRuns]) -> list[str]:
    """Methods whose run on the data as they are is none of what its replicates span."""
    outside: list[str] = []
    for method in methods:
        key = next((k for k, _, _ in best_settings.ERRORS if f"{k}_q1" in method.row), None)
        over = spread(method.runs, key) if key else None
        if over is not None and over.distinct >= SPANNING and over.outside:
            lone, ends = over.unperturbed, (over.best, over.worst)
            assert lone is not None
            low, high = map(render.three_digits, ends)
            name = f"{method.row['backend']} {verdict.label(method.row)}"
            outside.append(f"{name}: {render.three_digits(lone)}, replicates {low} to {high}")
    if not outside:
        return []
    more = len(outside) - REASONS
    listed = [f"  {line}" for line in outside[:REASONS]]
    listed += [f"  and {more} more"] if more > 0 else []
    return ["the run on the data as they are lies outside its replicates:", *listed]


def reuse(runs: Sequence[Run]) -> list[str]:
    """How many registrations were asked for and how many of them computed; nothing for runs
    that do not say so. A rejected registration does not tell whether it was reused."""
    asked = reused = rejected = 0
    for run in runs:
        share, coverage = run.metrics.get("reused"), run.metrics.get("coverage")
        scans = run.record.get("scans")
        registers = run.record["choices"].get("backend") != "none"
        if share is None or coverage is None or scans is None or not registers:
            continue
        accepted = round(coverage * (scans - 1))
        asked += accepted
        reused += round(share * accepted)
        rejected += run.metrics.get("rejected") or 0
    if not asked:
        return []
    words = f"registrations: asked {asked}, computed {asked - reused}, reused {reused / asked:.1%}"
    return [f"{words} (and {rejected} rejected ones)" if rejected else words]


def reasons(runs: Sequence[Run]) -> list[str]:
    """Failed runs by their reason, the most frequent first."""
    by_reason: dict[str, list[Run]] = {}
    for run in runs:
        if not run.done:
            by_reason.setdefault(_reason(run), []).append(run)
    if not by_reason:
        return []
    groups = sorted(by_reason.items(), key=lambda group: -len(group[1]))
    statuses = {run.record.get("status") for run in runs} - {"done"}
    word = "failed" if statuses == {"failed"} else "not done"
    lines = [f"{word}: {sum(len(group) for _, group in groups)} of {_runs(len(runs))}"]
    for reason, group in groups[:REASONS]:
        lines.append(f"  {len(group)} x {reason} ({_few([r.path.name for r in group])})")
    if len(groups) > REASONS:
        left = sum(len(group) for _, group in groups[REASONS:])
        lines.append(f"  {left} x {len(groups) - REASONS} other reasons: see table.csv")
    return lines


def _reason(run: Run) -> str:
    if run.record.get("reason"):
        return str(run.record["reason"])
    status = run.record.get("status")
    return "started, but never ended" if status == "started" else f"status {status}"


def comparison_warnings(runs: Sequence[Run]) -> list[str]:
    """A line for everything that makes rows of one table hard to compare: data that are not the
    same under the same name and seed, other versions, and repeated runs."""
    return [*_other_data(runs), *_other_versions(runs), *_repeated(runs)]


def _other_data(runs: Sequence[Run]) -> list[str]:
    words = frame.data_labels(runs)
    groups: dict[tuple[str, Any], list[Run]] = {}
    for run in runs:
        if run.record.get("dataset_fingerprint"):
            name = " ".join(filter(None, [run.record["choices"].get("dataset"), words[run.path]]))
            settings = run.config.get("dataset")
            seed = settings.get("seed") if isinstance(settings, dict) else None
            groups.setdefault((name, seed), []).append(run)
    lines: dict[str, list[str]] = {}
    for (name, seed), group in groups.items():
        by_fingerprint = _by_value(group, lambda run: data_set(run)[:12])
        if len(by_fingerprint) > 1:
            where = name if seed is None else f"{name}, seed {seed}"
            lines.setdefault(name, []).append(
                f"{where}: the data differ: {_values(by_fingerprint)}"
            )
    return [_first(of_name, "seed") for of_name in lines.values()]


def _other_versions(runs: Sequence[Run]) -> list[str]:
    names = dict.fromkeys(name for run in runs for name in run.record.get("versions") or {})
    lines = []
    for name in [*names, "git"]:

        def version(run: Run, name: str = name) -> str:
            versions = run.record if name == "git" else run.record.get("versions") or {}
            return str(versions.get(name) or "unknown")

        by_version = _by_value(runs, version)
        if len(by_version) > 1:
            what = "the checkout (git)" if name == "git" else name
            lines.append(f"{what} differs: {_values(by_version)}")
    return lines


def _repeated(runs: Sequence[Run]) -> list[str]:
    groups = Counter(
        (run.method, run.record.get("seed"), number_of(run), run.section("selector").get("offset"))
        for run in runs
    )
    again = sum(count - 1 for count in groups.values())
    if not again:
        return []
    words = "1 run repeats" if again == 1 else f"{again} runs repeat"
    return [f"{words} the settings and the seed of another; medians count each"]


def _by_value(runs: Sequence[Run], value: Callable[[Run], str]) -> dict[str, list[Run]]:
    groups: dict[str, list[Run]] = {}
    for run in runs:
        groups.setdefault(value(run), []).append(run)
    return groups


def _values(by_value: dict[str, list[Run]]) -> str:
    """ "0.20.0 in 34 runs (results/a), 0.19.0 in 1 run (results/b/rbtm)"."""
    parts = []
    for value, runs in by_value.items():
        few = len(runs) <= NAMED
        places = dict.fromkeys(str(run.path if few else run.path.parent) for run in runs)
        parts.append(f"{value} in {_runs(len(runs))} ({_few(list(places))})")
    return ", ".join(parts)


def _first(lines: list[str], what: str) -> str:
    more = len(lines) - 1
    return lines[0] + (f"; and so for {more} more {what}{'s' * (more > 1)}" if more else "")


def _few(names: Sequence[str]) -> str:
    more = len(names) - NAMED
    return ", ".join([*names[:NAMED], *([f"{more} more"] if more > 0 else [])])


def _runs(count: int) -> str:
    return "1 run" if count == 1 else f"{count} runs"


def failures(folders: Sequence[Path]) -> list[str]:
    """A line for every run that did not end well."""
    runs = stored.find_runs(folders)
    return [f"{r.path.name}: {r.record.get('reason')}" for r in runs if not r.done]
