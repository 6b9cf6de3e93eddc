"""The files of a calibration: a row a pair, a bin, a predictor, a method."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rbtm_bench.calibration import analysis
from rbtm_bench.calibration.analysis import ALL, EQUAL, Measured
from rbtm_bench.calibration.knee import Ends, Knee
from rbtm_bench.calibration.parts import PARTS
from rbtm_bench.calibration.sampling import GAP, Sample
from rbtm_bench.calibration.shortlist import Candidate, Gap, Shortlist
from rbtm_bench.calibration.trial import Trial, Verdict
from rbtm_bench.core import escape
from rbtm_bench.core.files import write_atomically, write_text

if TYPE_CHECKING:
    import pandas as pd

Key = tuple[str, str]
"""A backend and a similarity."""


@dataclass(frozen=True, eq=False)
class Findings:
    """Everything that a calibration concludes."""

    roc: pd.DataFrame
    curves: pd.DataFrame
    knees: Mapping[Key, Knee]
    gaps: Mapping[str, Sequence[Gap]]
    candidates: Mapping[str, Sequence[Candidate]]


def analyse(measured: Measured, samples: Sequence[Sample]) -> Findings:
    """What pairs say. Nothing is random but the resampling of blocks, whose seed is fixed."""
    lists = {backend: Shortlist(measured, backend, samples) for backend in measured.outcomes}
    return Findings(
        analysis.roc_rows(measured),
        analysis.summary_rows(measured),
        analysis.knees(measured),
        {backend: one.gaps for backend, one in lists.items()},
        {backend: one.candidates() for backend, one in lists.items()},
    )


def pair_rows(measured: Measured) -> pd.DataFrame:
    """A row a pair and backend."""
    import pandas as pd

    frames = [
        pd.concat([measured.pairs, outcome], axis=1).assign(backend=name)
        for name, outcome in measured.outcomes.items()
    ]
    return pd.concat(frames, ignore_index=True)


def score_rows(measured: Measured) -> pd.DataFrame:
    """A row a pair and similarity."""
    import pandas as pd

    columns = ["data", "target", "source", "gap", "group", "kind", "part"]
    frames = [
        measured.pairs[columns].assign(similarity=name, score=scores)
        for name, scores in measured.scores.items()
    ]
    return pd.concat(frames, ignore_index=True)


def summary(measured: Measured, findings: Findings) -> pd.DataFrame:
    """A row a backend and similarity: areas, cost of a score, knee."""
    import pandas as pd

    return pd.DataFrame([_summary_row(key, measured, findings) for key in findings.knees])


def _summary_row(key: Key, measured: Measured, findings: Findings) -> dict[str, Any]:
    backend, similarity = key
    row: dict[str, Any] = {"backend": backend, "similarity": similarity}
    for how, short in ((ALL, "auc_all_gaps"), (EQUAL, "auc_equal_gap")):
        area = one_area(findings.roc, backend, similarity, how)
        row |= {f"{short}{end}": area.get(f"auc{end}") for end in ("", "_low", "_high")}
    row["score_us"] = 1e6 * measured.costs.get(similarity, (np.nan, np.nan))[1]
    knee = findings.knees[key]
    row |= {"knee": knee.present, "knee_p": knee.p, "knee_smallest": knee.smallest}
    for name in ("threshold", "width", "rise"):
        ends = getattr(knee, name)
        for end, value in zip(("", "_low", "_high"), _three(ends), strict=True):
            row[f"knee_{name}{end}"] = value
    return row


def _three(ends: Ends | None) -> tuple[float | None, float | None, float | None]:
    return (None, None, None) if ends is None else (ends.value, ends.low, ends.high)


def gap_rows(findings: Findings) -> pd.DataFrame:
    """A row a backend and gap: the errors' means and spreads, and the drift that they predict."""
    import pandas as pd

    rows = []
    for backend, gaps in findings.gaps.items():
        for g in gaps:
            m, rad = g.errors.spread
            along, cross = g.errors.shift.mean(axis=0)[:2]
            row = {"backend": backend, "gap": g.gap, "pairs": g.pairs, "mean_along_m": along}
            row |= {"mean_cross_m": cross, "spread_m": m, "spread_deg": float(np.degrees(rad))}
            row["mean_heading_deg"] = float(np.degrees(g.errors.turn[:, 2].mean()))
            row |= {"drift_m": g.drift.value, "drift_low_m": g.drift.low}
            rows.append(row | {"drift_high_m": g.drift.high, "unsure": g.unsure})
    return pd.DataFrame(rows)


def trial_rows(verdicts: Mapping[str, Verdict]) -> pd.DataFrame:
    """A row a setting that was run, by backend and part; ``error``: the median of replicates."""
    import pandas as pd

    parts = [
        (backend, part, trial, trial.candidate.words == verdict.advice.candidate.words)
        for backend, verdict in verdicts.items()
        for part, trials in zip(PARTS, (verdict.tried, verdict.shown), strict=True)
        for trial in trials
    ]
    return pd.DataFrame([_trial_row(*one) for one in parts])


def _trial_row(backend: str, part: str, trial: Trial, advised: bool) -> dict[str, Any]:
    c = trial.candidate
    row: dict[str, Any] = {"backend": backend, "part": part, "setting": trial.name}
    row |= {"words": " ".join(c.words), "similarity": c.similarity, "advised": advised}
    row |= {"predicted_m": c.drift.value if c.drift else None, "error": trial.median}
    for name, q in (("q1", 0.25), ("q3", 0.75), ("worst", 1.0)):
        row[name] = float(np.quantile(trial.values, q, method="inverted_cdf"))
    row |= {"error_of_wheels": trial.of_wheels, "mean_gap": trial.mean("mean_gap")}
    row |= {"registrations_per_scan": trial.cost, "ms_per_scan": trial.mean("ms_per_scan")}
    return row | {"replicates": len(trial.values)}


def one_area(
    roc: pd.DataFrame, backend: str, predictor: str, how: str, part: str = "all", kind: str = GAP
) -> dict[str, Any]:
    """One row of ``roc`` as a dictionary, empty without one."""
    rows = roc[
        (roc["backend"] == backend)
        & (roc["predictor"] == predictor)
        & (roc["compared"] == how)
        & (roc["part"] == part)
        & (roc["pairs"] == kind)
    ]
    return {} if rows.empty else {str(k): v for k, v in rows.iloc[0].items()}


def write(
    measured: Measured, findings: Findings, verdicts: Mapping[str, Verdict], out: Path
) -> None:
    """``pairs.parquet``, ``scores.parquet``, ``roc.csv``, ``curves.csv``, ``gaps.csv``,
    ``trials.csv``, ``summary.csv`` and ``summary.md``; each appears whole or not at all."""
    table = summary(measured, findings)
    parquet = {"pairs": pair_rows(measured), "scores": score_rows(measured)}
    csv = {"roc": findings.roc, "curves": findings.curves, "summary": table}
    csv |= {"gaps": gap_rows(findings), "trials": trial_rows(verdicts)}
    files = {f"{name}.parquet": rows.to_parquet for name, rows in parquet.items()}
    files |= {f"{name}.csv": escape.csv_table(rows).to_csv for name, rows in csv.items()}
    for name, save in files.items():
        write_atomically(out / name, functools.partial(save, index=False))
    write_text(out / "summary.md", table.round(3).to_markdown(index=False) + "\n")
