"""The numbers of scripts/premise.py, from the folders of its runs alone.

Errors, of which less is better: on simulated data the final position error (mm), a number a seed,
medians; on raw logs the relation error (m), on keyframes with corrected poses the error over 10 m
of the way (m), both means with place-time clusters resampled.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.geometry import inverse, translation_norm
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array
from rbtm_bench.metrics.relation_errors import FILE, RelationErrors
from rbtm_bench.report import intervals
from rbtm_bench.report.intervals import Interval
from rbtm_bench.runs.stored import Run, read_run
from rbtm_bench.studies.premise.plan import (
    BOUNDS,
    CHANCE,
    NOTHING,
    RBTM,
    SIMULATED,
    STRATEGIES,
    Kind,
    Try,
)

SEGMENT_M = 10.0
"""m of the true way that a keyframe's error is taken over."""
BLOCK_M = 20.0
"""m of the true way; segments that start in one block are of one cluster."""
SIGNIFICANT = 0.05
RESAMPLES = 9999
LEAST = 1e-9
"""Errors below count as this much, so that a logarithm exists."""

Key = tuple[str, str, str]
"""Place, backend and strategy."""


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors (n,) with the cluster and the stratum of each; NaN where unknown."""

    values: Array
    clusters: NDArray[np.intp]
    strata: NDArray[np.bool_]
    median: bool

    @property
    def value(self) -> float:
        """Median or mean of all; NaN for none."""
        known = self.values[~np.isnan(self.values)]
        if len(known) == 0:
            return math.nan
        return float(np.median(known) if self.median else np.mean(known))

    def interval(self) -> Interval:
        """With its bootstrap interval."""
        known = self.values[~np.isnan(self.values)]
        if len(known) == 0:
            return Interval(math.nan, None, None, 0)
        if self.median:
            return intervals.interval(known)
        return intervals.cluster_interval(self.values, self.clusters, self.strata)

    def minus(self, other: Errors) -> tuple[Interval, float | None]:
        """The interval of the paired differences, and p of the signed-rank test over seeds."""
        off = self.values - other.values
        over = replace(self, values=off).interval()
        return over, intervals.signed_rank(off[~np.isnan(off)]) if self.median else None

    def beside(self, other: Errors) -> float:
        """Median or mean over what the other has as well."""
        return replace(self, values=np.where(np.isnan(other.values), np.nan, self.values)).value

    def lacks(self, other: Errors) -> bool:
        """Whether the other has an error that this one has not."""
        return bool((np.isnan(self.values) & ~np.isnan(other.values)).any())


def read(folder: Path, names: Sequence[str]) -> list[Run]:
    """The runs that are done, in this order; failed ones and missing ones are left out."""
    runs = []
    for name in names:
        try:
            run = read_run(folder / name)
        except DataError:
            continue
        if run.done:
            runs.append(run)
    return runs


def errors(runs: Sequence[Run], kind: Kind, seeds: Sequence[int] = ()) -> Errors | None:
    """The errors of a try: of simulated runs one a seed, NaN for those that failed; on a log those
    of its relations or segments, the mean over runs (draws of random_gap). None without any."""
    if kind.name == SIMULATED:
        by_seed = {
            run.record.get("seed"): run.metrics["final_translation_error_mm"] for run in runs
        }
        values = np.array([by_seed.get(seed, math.nan) for seed in seeds], np.float64)
        each = np.arange(len(values))
        return Errors(values, each, np.zeros(len(values), bool), median=True)
    if not runs:
        return None
    per_run = [_of_relations(run) if kind.name == "raw" else _of_segments(run) for run in runs]
    values = np.mean([one.values for one in per_run], axis=0)
    return Errors(values, per_run[0].clusters, per_run[0].strata, median=False)


def _of_relations(run: Run) -> Errors:
    relations = RelationErrors.read(run.path / FILE)
    clusters = intervals.relation_clusters(relations.start, relations.end, relations.local)
    return Errors(relations.translation_m, clusters, relations.local, median=False)


def _of_segments(run: Run) -> Errors:
    """The translation error (m) of the motion over the next 10 m, from every keyframe."""
    estimate = Trajectory.read_tum(run.path / "trajectory.tum").T_world_scan
    truth = Trajectory.read_tum(run.path / "ground_truth.tum").T_world_scan
    if len(estimate) != len(truth):
        raise DataError(f"{run.path}: {len(estimate)} poses, {len(truth)} true ones: expected both")
    return segments(estimate, truth)


def segments(estimate: Array, truth: Array) -> Errors:
    """Of poses (N, 4, 4): from every pose to the first one at least 10 m further on the true way.
    Raises ``DataError`` for a way that is no longer than that."""
    steps = np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    ends = np.searchsorted(way, way + SEGMENT_M)
    start = np.flatnonzero(ends < len(way))
    if len(start) == 0:
        raise DataError(f"a true way of {way[-1]:.3g} m: expected more than {SEGMENT_M:g} m")
    end = ends[start]
    off = inverse(inverse(truth[start]) @ truth[end]) @ (inverse(estimate[start]) @ estimate[end])
    clusters = np.floor(way[start] / BLOCK_M).astype(np.intp)
    return Errors(
        np.asarray(translation_norm(off)), clusters, np.zeros(len(start), bool), median=False
    )


def choose(scores: Mapping[tuple[str, int], float]) -> int:
    """The number of the try with the least mean logarithm of its errors; ``scores`` holds an error
    by data set (or seed) and try. A try that lacks one is chosen only where all do."""
    tries = sorted({k for _, k in scores})
    known = {k: [v for (_, j), v in scores.items() if j == k] for k in tries}
    lost = {k: sum(math.isnan(v) for v in values) for k, values in known.items()}

    def rank(k: int) -> tuple[float, float, int]:
        logs = [math.log(max(v, LEAST)) for v in known[k] if not math.isnan(v)]
        return lost[k], sum(logs) / len(logs) if logs else math.inf, k

    return min(tries, key=rank)


def share(random: Errors, ours: Errors, bound: Errors) -> Interval:
    """How much of the way from random_gap to the bound is covered: (random - ours) / (random -
    bound) of medians or means, with a percentile interval over seeds or clusters.

    NaN where the bound is not surely below random_gap: then no way is left to cover.
    """
    known = ~np.isnan(random.values + ours.values + bound.values)
    groups = np.unique(random.clusters[known], return_inverse=True)[1]
    columns = np.stack([one.values[known] for one in (random, ours, bound)])
    n = int(groups.max()) + 1 if len(groups) else 0
    if n < intervals.FEWEST_UNITS:
        return Interval(math.nan, None, None, n)
    drawn = np.random.default_rng(intervals.SEED).integers(0, n, (RESAMPLES, n))
    if random.median:
        value, sampled = np.median(columns, axis=1), np.median(columns[:, drawn], axis=2)
    else:
        sums = np.stack([np.bincount(groups, weights=column) for column in columns])
        counts = np.bincount(groups)
        value, sampled = (
            columns.mean(axis=1),
            sums[:, drawn].sum(axis=2) / counts[drawn].sum(axis=1),
        )
    gain = sampled[0] - sampled[2]
    if np.quantile(gain, 0.025) <= 0 or value[0] <= value[2]:
        return Interval(math.nan, None, None, n)
    low, high = np.quantile((sampled[0] - sampled[1]) / gain, [0.025, 0.975])
    return Interval(
        float((value[0] - value[1]) / (value[0] - value[2])), float(low), float(high), n
    )


@dataclass(frozen=True, eq=False)
class TryOutcome:
    """A chosen try on a place: its runs that are done, of how many, and their errors."""

    one: Try
    tried: int
    chosen_on: str
    runs: list[Run]
    asked: int
    errors: Errors | None


def table(outcomes: Mapping[Key, TryOutcome]) -> pd.DataFrame:
    """A row a place, backend and strategy."""
    rows = []
    for (place, backend, strategy), outcome in outcomes.items():
        kind = outcome.one.place.kind
        over = outcome.errors.interval() if outcome.errors else Interval(math.nan, None, None, 0)
        rows.append(
            {
                "place": place, "data": outcome.one.place.title, "backend": backend,
                "strategy": strategy, "setting": outcome.one.override, "tried": outcome.tried,
                "chosen_on": outcome.chosen_on,
                "unit": "mm" if kind.name == SIMULATED else "m", "error": over.value,
                "low": _number(over.low), "high": _number(over.high), "n": over.n,
                "failed": outcome.asked - len(outcome.runs),
                "mean_gap": _mean(outcome.runs, "mean_gap"),
                "fallbacks": _mean(outcome.runs, "fallbacks"),
                "rejected": _mean(outcome.runs, "rejected"),
                "ms_per_scan": _mean(outcome.runs, "ms_per_scan"),
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def against(outcomes: Mapping[Key, TryOutcome], ours: str = "rbtm") -> pd.DataFrame:
    """A row a place, backend and other strategy: rbtm minus it, paired. ``holds`` says "better" or
    "worse" where the interval excludes 0 and, over seeds, the signed-rank test adjusted for all
    comparisons of a place and backend (Holm) is below 0.05; never of a side of which a run failed
    where the other's did not."""
    rows: list[dict[str, Any]] = []
    for place, backend in dict.fromkeys((p, b) for p, b, s in outcomes if s == ours):
        group: list[dict[str, Any]] = []
        mine = outcomes[place, backend, ours].errors
        others = [(NOTHING, NOTHING), *((backend, s) for s in (*STRATEGIES, *BOUNDS) if s != ours)]
        for other_backend, strategy in others:
            outcome = outcomes.get((place, other_backend, strategy))
            theirs = outcome.errors if outcome else None
            if mine is None or theirs is None:
                continue
            over, p = mine.minus(theirs)
            row: dict[str, Any] = {"place": place, "backend": backend, "strategy": strategy}
            row |= {"rbtm": mine.beside(theirs), "other": theirs.beside(mine)}
            row |= {"difference": over.value, "low": _number(over.low), "high": _number(over.high)}
            winner, loser = (mine, theirs) if over.value < 0 else (theirs, mine)
            # the runs that failed are not in the difference: their side is not called better
            sure = over.excludes(0) and not winner.lacks(loser)
            group.append({**row, "n": over.n, "p": p, "tested": mine.median, "sure": sure})
        for row, p in zip(group, intervals.holm([row["p"] for row in group]), strict=True):
            tested = row.pop("tested")
            holds = row.pop("sure") and (not tested or (p is not None and p < SIGNIFICANT))
            row["p_holm"] = math.nan if p is None else p
            row["holds"] = ("better" if row["difference"] < 0 else "worse") if holds else ""
        rows += group
    return pd.DataFrame(rows)


def shares(outcomes: Mapping[Key, TryOutcome], bound: str = "oracle") -> pd.DataFrame:
    """A row a place, backend and method between chance and the bound: ``share``."""
    rows = []
    for place, backend in dict.fromkeys((p, b) for p, b, s in outcomes if s == bound):
        for strategy in RBTM:
            ends = [outcomes[place, backend, name].errors for name in (chance_of(strategy), bound)]
            mine = outcomes[place, backend, strategy].errors
            if mine is None or ends[0] is None or ends[1] is None:
                continue
            over = share(ends[0], mine, ends[1])
            row: dict[str, Any] = {"place": place, "backend": backend, "strategy": strategy}
            row["bound"] = bound
            row |= {"random": ends[0].value, "error": mine.value, "oracle": ends[1].value}
            row |= {"share": over.value, "low": _number(over.low), "high": _number(over.high)}
            rows.append({**row, "n": over.n})
    return pd.DataFrame(rows)


def chance_of(ours: str) -> str:
    """The random gaps of an RBTM: its own, or those of the same similarity without a check."""
    return next((name for name, of in CHANCE.items() if of == ours), "random_gap")


def pooled_share(outcomes: Mapping[Key, TryOutcome], ours: str, bound: str = "oracle") -> Interval:
    """The share over all simulated places and backends, of logarithms, so that a ratio counts the
    same everywhere: mean log(random / ours) over mean log(random / bound). Seeds are resampled,
    each with all its places and backends."""
    ways, gains = [], []
    for place, backend, strategy in outcomes:
        if strategy != bound or outcomes[place, backend, bound].one.place.kind.name != SIMULATED:
            continue
        three = [outcomes[place, backend, name].errors for name in (chance_of(ours), ours, bound)]
        if all(three):
            logs = [np.log(np.maximum(one.values, LEAST)) for one in three if one]
            ways.append(logs[0] - logs[1])
            gains.append(logs[0] - logs[2])
    if not ways:
        return Interval(math.nan, None, None, 0)
    way, gain = np.stack(ways), np.stack(gains)
    complete = ~np.isnan(way + gain).any(axis=0)  # seeds of which no run has failed
    way, gain, n = (
        way[:, complete].mean(axis=0),
        gain[:, complete].mean(axis=0),
        int(complete.sum()),
    )
    value = float(way.mean() / gain.mean()) if n and gain.mean() > 0 else math.nan
    if n < intervals.FEWEST_UNITS:
        return Interval(value, None, None, n)
    drawn = np.random.default_rng(intervals.SEED).integers(0, n, (RESAMPLES, n))
    below = gain[drawn].mean(axis=1)
    if np.quantile(below, 0.025) <= 0:
        return Interval(math.nan, None, None, n)
    low, high = np.quantile(way[drawn].mean(axis=1) / below, [0.025, 0.975])
    return Interval(value, float(low), float(high), n)


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _mean(runs: Sequence[Run], key: str) -> float:
    known = [float(run.metrics[key]) for run in runs if run.metrics.get(key) is not None]
    return sum(known) / len(known) if known else math.nan
