"""From pairs, scores and outcomes to the answers: every table that a calibration writes.

The same functions serve ``rbtm-bench calibrate`` and scripts that compare similarities over many
logs: give ``roc_rows`` the frames of ``Measured`` of several data sets, concatenated.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rbtm_bench.calibration import rates
from rbtm_bench.calibration.knee import Knee, knee
from rbtm_bench.calibration.parts import REPORTED
from rbtm_bench.calibration.roc import Area, area, ranks_within
from rbtm_bench.calibration.sampling import GAP, REVISIT
from rbtm_bench.core.types import Array

if TYPE_CHECKING:
    import pandas as pd

PREDICTORS: Mapping[str, str] = {
    "gap": "gap (scans)",
    "travelled_m": "distance travelled",
    "distance_m": "distance between",
    "rotation_deg": "rotation between",
}
"""What is known of a pair without its points; small values should mean success."""
ALL, EQUAL = "all gaps", "equal gap"


@dataclass(frozen=True, eq=False)
class Measured:
    """A calibration's raw material.

    ``pairs``: a row a pair (columns of ``Sample.rows``, and ``data``, the number of its data set;
    clusters of different data sets differ). ``outcomes``: by backend, its rows beside those of
    ``pairs`` (error_m, error_deg, success, seconds, reason ...). ``scores``: by similarity, (K,).
    ``windows`` and ``offered``: what windows offer, and by similarity its scores. ``costs``: by
    similarity, seconds a descriptor and a pair's score.
    """

    pairs: pd.DataFrame
    outcomes: Mapping[str, pd.DataFrame]
    scores: Mapping[str, Array]
    windows: pd.DataFrame
    offered: Mapping[str, Array]
    costs: Mapping[str, tuple[float, float]]


def successes(outcome: pd.DataFrame, within: tuple[float, float]) -> Array:
    """(K,) bool: the error is at most ``within`` (m, deg); a failed registration is no success."""
    success = (outcome["error_m"] <= within[0]) & (outcome["error_deg"] <= within[1])
    return np.asarray(success, bool)


def roc_rows(measured: Measured) -> pd.DataFrame:
    """A row a backend, kind of pairs, part (all, reported), comparison (all gaps, equal gap) and
    predictor: area, low, high, its difference from the gap's area, counts and costs."""
    import pandas as pd

    area_rows: list[dict[str, Any]] = []
    for backend, outcome in measured.outcomes.items():
        for kind, part, inside in _kinds_and_parts(measured.pairs):
            rows, success = measured.pairs[inside], outcome["success"].to_numpy(bool)[inside]
            clusters = rows["cluster"].to_numpy()
            for how in (ALL, EQUAL) if kind == GAP else (ALL,):
                strata = _strata(rows) if how == EQUAL else _data(rows)
                areas = {
                    name: area(values, success, clusters, strata)
                    for name, values in _predictors(measured, rows, inside).items()
                }
                head = {"backend": backend, "pairs": kind, "part": part, "compared": how}
                area_rows += [
                    {**head, **_area_row(name, areas, measured, inside)} for name in areas
                ]
    return pd.DataFrame(area_rows)


def _kinds_and_parts(pairs: pd.DataFrame) -> Iterator[tuple[str, str, Any]]:
    for kind in (GAP, REVISIT):
        for part in ("all", REPORTED):
            inside = (pairs["kind"] == kind).to_numpy()
            if part == REPORTED:
                inside = inside & (pairs["part"] == REPORTED).to_numpy()
            if inside.any():
                yield kind, part, inside


def _data(rows: pd.DataFrame) -> Any:
    return rows["data"].to_numpy()


def _strata(rows: pd.DataFrame) -> Any:
    """One number a data set and group of gaps."""
    return rows["data"].to_numpy() * 1_000_000 + rows["group"].to_numpy()


def _predictors(measured: Measured, rows: pd.DataFrame, inside: Any) -> dict[str, Array]:
    """By name, numbers (K,) that should be larger for successes."""
    predictors = {name: scores[inside] for name, scores in measured.scores.items()}
    for column in PREDICTORS:
        values = -rows[column].to_numpy(np.float64)
        if np.isfinite(values).any():
            predictors[column] = values
    return predictors


def _area_row(
    name: str, areas: Mapping[str, Area], measured: Measured, inside: Any
) -> dict[str, Any]:
    roc_area = areas[name]
    row: dict[str, Any] = {
        "predictor": name,
        "auc": roc_area.value,
        "auc_low": roc_area.low,
        "auc_high": roc_area.high,
        "successes": roc_area.successes,
        "failures": roc_area.failures,
        "couples": roc_area.couples,
        "blocks": roc_area.blocks,
    }
    if name in measured.scores:
        undefined = int(np.isnan(measured.scores[name][inside]).sum())
        describe, score = measured.costs.get(name, (np.nan, np.nan))
        minus = dict(zip(("", "_low", "_high"), roc_area.minus(areas["gap"]), strict=True))
        row |= {f"minus_gap{end}": value for end, value in minus.items()}
        row |= {"undefined": undefined, "describe_us": 1e6 * describe, "score_us": 1e6 * score}
    return row


def summary_rows(measured: Measured) -> pd.DataFrame:
    """Success and errors over similarity: a row a backend, similarity, kind of pairs, gap ("all",
    "equal": over ranks within the gap, or a gap) and bin. The last bin of each is "undefined"."""
    import pandas as pd

    bin_rows: list[dict[str, Any]] = []
    for backend, outcome in measured.outcomes.items():
        for name, scores in measured.scores.items():
            head = {"backend": backend, "similarity": name}
            for kind in (GAP, REVISIT):
                inside = np.flatnonzero(measured.pairs["kind"] == kind)
                if len(inside) == 0:
                    continue
                rows = measured.pairs.iloc[inside]
                for gap, x, some in _views(kind, rows, scores[inside]):
                    bin_rows += [
                        {**head, "pairs": kind, "gap": gap, **row}
                        for row in _bin_rows(x[some], inside[some], measured.pairs, outcome)
                    ]
    return pd.DataFrame(bin_rows)


def _views(kind: str, rows: pd.DataFrame, scores: Array) -> Iterator[tuple[str, Array, Any]]:
    """What success is looked at over: the score of all, the rank within the gap of all, and the
    score of each gap."""
    every = np.arange(len(rows))
    yield "all", scores, every
    if kind == GAP:
        yield "equal", ranks_within(scores, _strata(rows)), every
        groups = rows["group"].to_numpy()
        for group in np.unique(groups):
            yield str(group), scores, np.flatnonzero(groups == group)


def _bin_rows(
    x: Array, inside: Any, pairs: pd.DataFrame, outcome: pd.DataFrame
) -> Iterator[dict[str, Any]]:
    success = outcome["success"].to_numpy(bool)[inside]
    errors = {key: outcome[key].to_numpy()[inside] for key in ("error_m", "error_deg")}
    clusters = pairs["cluster"].to_numpy()[inside]
    count = rates.BINS if len(x) >= 100 else 4
    bins = [(str(k), *one_bin) for k, one_bin in enumerate(rates.bins_of(x, count))]
    undefined = np.flatnonzero(np.isnan(x))
    if len(undefined):
        bins.append(("undefined", np.nan, np.nan, undefined))
    for name, low, high, members in bins:
        share = rates.rate(success[members], clusters[members])
        row = {"bin": name, "low": low, "high": high, "n": share.n, "blocks": share.blocks}
        row |= {"success": share.value, "success_low": share.low, "success_high": share.high}
        for key, values in errors.items():
            quantiles = rates.quantiles(values[members])
            for q, value in zip(rates.QUANTILES, quantiles, strict=True):
                row[f"{key}_q{100 * q:.0f}"] = value
        yield row


def knees(measured: Measured) -> dict[tuple[str, str], Knee]:
    """A knee (or none) for every backend and similarity, over all pairs across gaps."""
    inside = (measured.pairs["kind"] == GAP).to_numpy()
    clusters = measured.pairs["cluster"].to_numpy()[inside]
    return {
        (backend, name): knee(scores[inside], outcome["error_m"].to_numpy()[inside], clusters)
        for backend, outcome in measured.outcomes.items()
        for name, scores in measured.scores.items()
    }
