"""The files of a calibration: a row a pair, a bin, a predictor, a method."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rbtm_bench.calibration import analysis
from rbtm_bench.calibration.advice import Advice
from rbtm_bench.calibration.analysis import ALL, EQUAL, Measured
from rbtm_bench.calibration.knee import Knee
from rbtm_bench.calibration.sampling import GAP
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
    advices: Mapping[Key, Advice]
    best: Key | None


def analyse(measured: Measured, wanted: float) -> Findings:
    """All answers. Nothing is random but the resampling of blocks, whose seed is fixed."""
    advices = analysis.advices(measured, wanted)
    return Findings(
        analysis.roc_rows(measured),
        analysis.summary_rows(measured),
        analysis.knees(measured),
        advices,
        analysis.best_of(advices),
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
    """A row a backend and similarity: areas, knee, advice and what it did on the reported part."""
    import pandas as pd

    return pd.DataFrame([_summary_row(key, measured, findings) for key in findings.advices])


def _summary_row(key: Key, measured: Measured, findings: Findings) -> dict[str, Any]:
    backend, similarity = key
    row: dict[str, Any] = {"backend": backend, "similarity": similarity}
    for how, short in ((ALL, "auc_all_gaps"), (EQUAL, "auc_equal_gap")):
        area = one_area(findings.roc, backend, similarity, how)
        row |= {f"{short}{end}": area.get(f"auc{end}") for end in ("", "_low", "_high")}
    row["score_us"] = 1e6 * measured.costs.get(similarity, (np.nan, np.nan))[1]
    knee, advice = findings.knees[key], findings.advices[key]
    row |= {"knee": knee.threshold if knee.present else None}
    row |= {"knee_low": knee.low if knee.present else None}
    row |= {"knee_high": knee.high if knee.present else None}
    row |= {"wanted": advice.wanted, "reached": advice.reached}
    chosen, reported = advice.chosen, advice.reported
    row["threshold"] = chosen.threshold if chosen else None
    row["window"] = chosen.window if chosen else None
    for name, promise in (("calibration", chosen), ("reported", reported)):
        rate = promise.success if promise else None
        row[f"{name}_success"] = rate.value if rate else None
        row[f"{name}_success_low"] = rate.low if rate else None
        row[f"{name}_success_high"] = rate.high if rate else None
        row[f"{name}_pairs"] = promise.pairs if promise else None
        row[f"{name}_used"] = promise.used if promise else None
        row[f"{name}_mean_gap"] = promise.reach if promise else None
    row["previous_success"] = advice.previous.value if advice.previous else None
    row["best"] = key == findings.best
    return row


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


def write(measured: Measured, findings: Findings, out: Path) -> list[Path]:
    """``pairs.parquet``, ``scores.parquet``, ``roc.csv``, ``curves.csv``, ``summary.csv`` and
    ``summary.md``; each appears whole or not at all."""
    table = summary(measured, findings)
    parquet = {"pairs": pair_rows(measured), "scores": score_rows(measured)}
    csv = {"roc": findings.roc, "curves": findings.curves, "summary": table}
    text = table.round(3).to_markdown(index=False) + "\n"
    written = [
        *(out / f"{name}.parquet" for name in parquet),
        *(out / f"{name}.csv" for name in csv),
    ]
    for path, rows in zip(written, [*parquet.values(), *csv.values()], strict=True):
        save = rows.to_parquet if path.suffix == ".parquet" else rows.to_csv
        write_atomically(path, functools.partial(save, index=False))
    write_text(out / "summary.md", text)
    return [*written, out / "summary.md"]
