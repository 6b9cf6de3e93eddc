"""The numbers of scripts/reproduce_paper.py, from the folders of its runs alone."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from tabulate import tabulate

from rbtm_bench.core.errors import DataError
from rbtm_bench.report import intervals
from rbtm_bench.report.intervals import Interval
from rbtm_bench.runs.stored import Run, read_run
from rbtm_bench.studies.paper.plan import PAPER_BACKEND, RATIO, PaperSize, stem_of
from rbtm_bench.studies.paper.ways import NAMES, PaperWay

ERROR = "final_translation_error_mm"
PARTS = {
    "along_mm": "final_along_mm",
    "cross_mm": "final_cross_mm",
    "heading_deg": "final_heading_error_deg",
}
SIGNIFICANT = 0.05
BLIND_CONTROLS = ("fixed_gap", "keyframe", "oldest", "random_gap")

Choice = Mapping[tuple[str, str], int]
"""The number of the chosen try by way and backend."""


def read(out: Path, names: Sequence[str]) -> list[Run]:
    """The runs that are done, in the order of their names' list."""
    runs = []
    for name in names:
        try:
            run = read_run(out / name)
        except DataError:
            continue
        if run.done and run.metrics.get(ERROR) is not None:
            runs.append(run)
    return runs


def values(runs: Sequence[Run], key: str) -> list[float]:
    """A metric of every run that has it."""
    return [float(run.metrics[key]) for run in runs if run.metrics.get(key) is not None]


def median(numbers: Sequence[float]) -> float:
    """NaN for no numbers."""
    return float(np.median(numbers)) if len(numbers) else math.nan


def fired(runs: Sequence[Run]) -> dict[str, int]:
    """The number of scans, the first of a run aside, and of how many the model scan was chosen by
    the method: not by its fallback."""
    scans = sum(int(run.record["scans"]) - 1 for run in runs)
    return {"fired": scans - round(sum(values(runs, "fallbacks"))), "scans": scans}


def ratio_of(above: Sequence[Run], below: Sequence[Run]) -> Interval | None:
    """How many times larger the error is on the same data: the median over seeds of a seed's own
    ratio, with its interval. None without a common seed."""
    known = {replicate(run): float(run.metrics[ERROR]) for run in above}
    pairs = [(known.get(replicate(run)), float(run.metrics[ERROR])) for run in below]
    quotients = [a / b for a, b in pairs if a is not None and b > 0]
    return intervals.interval(quotients) if quotients else None


def replicate(run: Run) -> str:
    """The seed, or the sensor's beams, of a run: the end of its name."""
    return run.path.name.rpartition("-")[2]


def choices(out: Path, ways: Mapping[str, PaperWay], size: PaperSize) -> pd.DataFrame:
    """A row a try: its median error on the seeds that choose. The smallest is chosen, of equal
    ones the first."""
    rows = []
    for way in ways.values():
        key, replicates = size.replicates(way.noise_mm, choosing=True)
        for backend in size.backends:
            tried: list[dict[str, Any]] = []
            for k in range(len(way.values)):
                runs = read(out, [f"{stem_of(way.key, k, backend)}-{r}" for r in replicates])
                tried.append(
                    {
                        "way": way.key, "method": way.name, "backend": backend, "try": k,
                        "setting": way.setting(k), "chosen_on": f"{key}={_listed(replicates)}",
                        "runs": len(runs), "failed": len(replicates) - len(runs),
                        "median_error_mm": median(values(runs, ERROR)), **fired(runs),
                    }
                )  # fmt: skip
            whole = [row for row in tried if row["failed"] == 0] or tried
            best = min(whole, key=lambda row: (math.isnan(e := row["median_error_mm"]), e))
            rows += [{**row, "chosen": row is best} for row in tried]
    return pd.DataFrame(rows)


def chosen(table: pd.DataFrame) -> dict[tuple[str, str], int]:
    """The chosen tries of ``choices``."""
    rows = table[table["chosen"]]
    return {
        (w, b): int(k) for w, b, k in zip(rows["way"], rows["backend"], rows["try"], strict=True)
    }


def table1(
    out: Path, ways: Mapping[str, PaperWay], size: PaperSize, choice: Choice
) -> pd.DataFrame:
    """Table I: a row a backend and method, on the seeds that are shown.

    ``standard_over_this`` is the ratio of the standard ICP's error to this one's (``ratio_of``).
    ``smaller_than_rbtm`` counts the seeds on which the error is below that of RBTM with the
    circular descriptor, ``p_holm`` tests the paired differences, adjusted within a backend.
    """
    rows: list[dict[str, Any]] = []
    for backend in size.backends:
        runs_of: dict[str, list[Run]] = {}
        group = []
        for way in ways.values():
            key, replicates = size.replicates(way.noise_mm, choosing=False)
            k = choice[way.key, backend]
            names = [f"{stem_of(way.key, k, backend)}-{r}" for r in replicates]
            runs = runs_of[way.key] = read(out, names)
            standard = runs_of["standard_clean" if way.noise_mm == 0 else "standard"]
            group.append(
                {
                    "backend": backend, "method": way.name, "way": way.key,
                    "noise_mm": way.noise_mm, "setting": way.setting(k), "brief": way.brief(k),
                    "tried": len(way.values),
                    "chosen_on": f"{key}={_listed(size.replicates(way.noise_mm, True)[1])}",
                    "shown_on": f"{key}={_listed(replicates)}",
                    "failed": len(names) - len(runs), **_numbers(runs, standard),
                }
            )  # fmt: skip
        rows += _tested(group, runs_of)
    return pd.DataFrame(rows)


def _numbers(runs: Sequence[Run], standard: Sequence[Run]) -> dict[str, Any]:
    errors = values(runs, ERROR)
    spread = intervals.interval(errors) if errors else None
    row: dict[str, Any] = {
        "runs": len(runs),
        "median_error_mm": spread.value if spread else math.nan,
        "low_mm": spread.low if spread else None,
        "high_mm": spread.high if spread else None,
        "largest_error_mm": max(errors, default=math.nan),
    }
    row |= {name: median(values(runs, key)) for name, key in PARTS.items()}
    heading = values(runs, PARTS["heading_deg"])
    row["largest_heading_deg"] = max(map(abs, heading), default=math.nan)
    ratio = ratio_of(standard, runs)
    row["standard_over_this"] = ratio.value if ratio else math.nan
    row["standard_over_low"] = ratio.low if ratio else None
    row["standard_over_high"] = ratio.high if ratio else None
    row |= fired(runs)
    row["mean_gap"] = median(values(runs, "mean_gap"))
    row["ms_per_scan"] = median(values(runs, "ms_per_scan"))
    return row


def _tested(rows: list[dict[str, Any]], runs_of: Mapping[str, list[Run]]) -> list[dict[str, Any]]:
    """The rows of a backend beside its RBTM with the circular descriptor, on the same data."""
    ours = {replicate(run): run.metrics[ERROR] for run in runs_of["circular"]}
    tests: list[float | None] = []
    for row in rows:
        pairs = [
            (run.metrics[ERROR], ours[replicate(run)])
            for run in runs_of[row["way"]]
            if row["noise_mm"] > 0 and row["way"] != "circular" and replicate(run) in ours
        ]
        row["smaller_than_rbtm"] = sum(a < b for a, b in pairs) if pairs else None
        tests.append(intervals.signed_rank([a - b for a, b in pairs]) if pairs else None)
    for row, p in zip(rows, intervals.holm(tests), strict=True):
        row["p_holm"] = p
    return rows


def against_controls(table: pd.DataFrame) -> pd.DataFrame:
    """A row a backend and control: RBTM with the circular descriptor beside it.

    ``verdict`` is that of RBTM: better or worse only where the paired test over seeds holds,
    adjusted for a backend's comparisons.
    """
    rows = []
    for backend, group in table.groupby("backend", sort=False):
        by_way = group.set_index("way")
        ours = float(by_way.loc["circular", "median_error_mm"])
        for control in BLIND_CONTROLS:
            other, p = (by_way.loc[control, key] for key in ("median_error_mm", "p_holm"))
            holds = not pd.isna(p) and p < SIGNIFICANT
            rows.append(
                {
                    "backend": backend, "control": control, "rbtm_mm": ours,
                    "control_mm": float(other), "p_holm": p,
                    "verdict": ("better" if ours < other else "worse") if holds else "",
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def ratios(out: Path, cells: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """A row a cell of the ratio's grid, with medians over seeds and the ratio's interval."""
    rows = []
    for cell in cells:
        runs_of = {way: read(out, cell[way]) for way in RATIO}
        row: dict[str, Any] = {k: cell[k] for k in ("scans", "noise_mm", "distance_m")}
        row["runs"] = len(runs_of["standard"])
        for way, runs in runs_of.items():
            row[f"{way}_mm"] = median(values(runs, ERROR))
            for part, key in PARTS.items():
                row[f"{way}_{part}"] = median(values(runs, key))
        for way in RATIO[1:]:
            ratio = ratio_of(runs_of["standard"], runs_of[way])
            row[f"standard_over_{way}"] = ratio.value if ratio else math.nan
            row[f"standard_over_{way}_low"] = ratio.low if ratio else None
            row[f"standard_over_{way}_high"] = ratio.high if ratio else None
        rows.append(row)
    return pd.DataFrame(rows)


def open_settings(out: Path, rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """A row a changed setting: errors and their parts, and how the heading spreads over seeds."""
    lines = []
    for row in rows:
        line: dict[str, Any] = {"change": row["change"]}
        runs = {way: read(out, row[way]) for way in ("standard", "circular") if way in row}
        for way, members in runs.items():
            line[f"{way}_mm"] = median(values(members, ERROR))
            for part, key in PARTS.items():
                line[f"{way}_{part}"] = median(values(members, key))
            heading = values(members, PARTS["heading_deg"])
            cross = values(members, PARTS["cross_mm"])
            line[f"{way}_heading_mean_deg"] = float(np.mean(heading)) if heading else math.nan
            line[f"{way}_heading_sd_deg"] = float(np.std(heading, ddof=len(heading) > 1))
            line[f"{way}_largest_heading_deg"] = max(map(abs, heading), default=math.nan)
            line[f"{way}_largest_cross_mm"] = max(map(abs, cross), default=math.nan)
            line[f"{way}_runs"] = len(members)
        line |= {f"circular_{name}": count for name, count in fired(runs["circular"]).items()}
        if "standard" in runs:
            ratio = ratio_of(runs["standard"], runs["circular"])
            line["ratio"] = ratio.value if ratio else math.nan
        lines.append(line)
    return pd.DataFrame(lines)


def held(run: Run) -> tuple[float, float, float]:
    """How well the matched surfaces hold a run's motions, medians over scans: the smallest and the
    largest eigenvalue of the localizability, and the angle in deg between the least held direction
    and the x axis of the scan, along which the robot drives."""
    steps = pd.read_parquet(
        run.path / "steps.parquet", columns=["localizability", "weak_direction"]
    )
    steps = steps.dropna()
    eigenvalues = np.stack(steps["localizability"].to_list())
    weak = np.stack(steps["weak_direction"].to_list())
    angle = np.degrees(np.arccos(np.clip(np.abs(weak[:, 0]), 0.0, 1.0)))
    return (
        float(np.median(eigenvalues[:, 0])), float(np.median(eigenvalues[:, -1])),
        float(np.median(angle)),
    )  # fmt: skip


def median_run(out: Path, names: Sequence[str]) -> Run:
    """The run whose error is nearest to the median: neither the best nor the worst picture."""
    runs = read(out, names)
    if not runs:
        raise DataError(f"{out}: none of {', '.join(names)} is done")
    middle = median(values(runs, ERROR))
    return min(runs, key=lambda run: abs(run.metrics[ERROR] - middle))


def paper_icp(table: pd.DataFrame) -> pd.DataFrame:
    """Table I in short: the rows of the paper's ICP."""
    rows = [
        {
            "method": row["method"],
            "setting": row["brief"],
            "median mm": number(row["median_error_mm"]),
            "95% interval": between(row["low_mm"], row["high_mm"]),
            "along mm": number(row["along_mm"]),
            "cross mm": number(row["cross_mm"]),
            "heading deg": number(row["heading_deg"]),
            "standard / this": number(row["standard_over_this"]),
        }
        for row in table[table["backend"] == PAPER_BACKEND].to_dict("records")
    ]
    return pd.DataFrame(rows)


def by_backend(table: pd.DataFrame) -> pd.DataFrame:
    """The medians of Table I, a row a backend; behind a control how RBTM (circular) compares:
    (+) shown better, (-) shown worse, as in ``against_controls``."""
    verdicts = against_controls(table).set_index(["backend", "control"])["verdict"]
    marks = {"better": " (+)", "worse": " (-)", "": ""}
    rows = []
    for backend, group in table.groupby("backend", sort=False):
        row = {"backend": backend}
        for way, mm in zip(group["way"], group["median_error_mm"], strict=True):
            mark = marks[verdicts.loc[backend, way]] if way in BLIND_CONTROLS else ""
            row[NAMES[way][1]] = number(mm) + mark
        rows.append(row)
    return pd.DataFrame(rows)


def between(low: float | None, high: float | None) -> str:
    """An interval in words; nothing without one."""
    if low is None or high is None or low != low or high != high:
        return ""
    return f"{number(low)} to {number(high)}"


def number(value: float | None) -> str:
    """Two digits, above 100 all before the point, no exponent; nothing for NaN, infinity or
    None."""
    if value is None or not math.isfinite(value):
        return ""
    return f"{value:.0f}" if abs(value) >= 99.5 else f"{float(f'{value:.2g}'):g}"


def markdown(table: pd.DataFrame) -> str:
    """A table of words as Markdown."""
    words = table.map(lambda value: "" if value is None else str(value))
    return tabulate(
        words.to_numpy().tolist(), list(map(str, words)), tablefmt="pipe", disable_numparse=True
    )


def _listed(numbers: Sequence[int]) -> str:
    """ "0-19" for consecutive numbers, else "661,701"."""
    first, last = numbers[0], numbers[-1]
    if len(numbers) > 2 and list(numbers) == list(range(first, last + 1)):
        return f"{first}-{last}"
    return ",".join(map(str, numbers))
