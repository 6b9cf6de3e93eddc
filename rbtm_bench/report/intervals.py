"""What the numbers of several runs bear out: intervals, paired tests, clusters.

The unit of an interval is what was drawn independently: a simulated data set (a seed of an
environment), or a cluster of relations of a log. docs/statistics.md gives the reasons.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rbtm_bench.core.trajectory import Mask
from rbtm_bench.core.types import Array

Statistic = Literal["median", "mean"]
Labels = NDArray[np.intp]

LEVEL = 0.95
RESAMPLES = 9999
MOST_NUMBERS = 20_000_000
"""Drawn at a time: 160 MB."""
SEED = 0
"""Every interval draws from a generator of its own with this seed: same numbers, same bits."""

FEWEST_UNITS = 3
"""Fewer units give no interval at all."""

INDEPENDENT = 6
"""Independent data sets that a rank or a test takes at least. With five, the exact
two-sided signed-rank test cannot fall below 2/32 = 0.06, whatever the differences."""

PLACE_S = 20.0
"""s; long relations whose starts and whose ends are at most this far apart are of one cluster."""
BLOCK_S = 30.0
"""s; local relations are of one cluster if their middles fall into one block of this length."""


@dataclass(frozen=True)
class Interval:
    """A statistic of ``n`` units with its bootstrap interval, None where it has none."""

    value: float
    low: float | None
    high: float | None
    n: int

    def excludes(self, value: float) -> bool:
        """True if the interval exists and ``value`` lies outside."""
        return self.low is not None and self.high is not None and not self.low <= value <= self.high


def interval(values: ArrayLike, statistic: Statistic = "median") -> Interval:
    """Median or mean of independent values (n,) with its interval.

    Percentile bootstrap for the median, BCa for the mean (Efron 1987). Raises ``ValueError`` for
    no values.
    """
    data = np.asarray(values, np.float64)
    if data.ndim != 1 or len(data) == 0:
        raise ValueError(f"expected at least one value, got shape {data.shape}")
    function: Callable[..., Any] = np.mean if statistic == "mean" else np.median
    method = "percentile" if statistic == "median" else "BCa"
    value = float(function(data))
    if len(data) < FEWEST_UNITS:
        return Interval(value, None, None, len(data))
    return Interval(value, *_bootstrap((data,), function, method), len(data))


def ratio_interval(ours: Array, theirs: Array) -> Interval | None:
    """Median of ``ours`` over median of ``theirs`` (n,), pairs resampled together (percentiles);
    None where a value is not positive."""
    if not ((ours > 0).all() and (theirs > 0).all()):
        return None
    value = float(np.median(ours) / np.median(theirs))
    if len(ours) < FEWEST_UNITS:
        return Interval(value, None, None, len(ours))

    def ratio(drawn: Array, axis: int = -1) -> Any:
        i = drawn.astype(np.intp)
        return np.median(ours[i], axis=axis) / np.median(theirs[i], axis=axis)

    pairs = np.arange(len(ours), dtype=np.float64)
    return Interval(value, *_bootstrap((pairs,), ratio, "percentile"), len(ours))


def cluster_interval(errors: Array, clusters: Labels, strata: ArrayLike) -> Interval:
    """Mean of the errors (R,) with an interval from resampling whole clusters; ``n`` counts them.

    ``clusters`` (R,) are their labels, ``strata`` (R,) what must keep its share: local and long
    relations are in a log as whoever made them wished, so each kind is resampled by itself. A
    cluster lies in one stratum. NaN errors are left out. No interval if a stratum has fewer than
    three clusters.
    """
    measured = ~np.isnan(errors)
    errors, clusters, kinds = errors[measured], clusters[measured], np.asarray(strata)[measured]
    if len(errors) == 0:
        raise ValueError("expected at least one error")
    sums, counts, shares = [], [], []
    for kind in np.unique(kinds):
        inside = kinds == kind
        labels = np.unique(clusters[inside], return_inverse=True)[1]
        sums.append(np.bincount(labels, weights=errors[inside]))
        counts.append(np.bincount(labels))
        shares.append(inside.mean())
    n = sum(len(count) for count in counts)
    value = float(errors.mean())
    if min(len(count) for count in counts) < FEWEST_UNITS:
        return Interval(value, None, None, n)

    def mean(*drawn: Array, axis: int = -1) -> Any:
        """The mean for numbers of clusters drawn from each stratum."""
        total: Any = 0.0
        for share, s, c, index in zip(shares, sums, counts, drawn, strict=True):
            i = index.astype(np.intp)
            total = total + share * s[i].sum(axis=axis) / c[i].sum(axis=axis)
        return total

    numbers = tuple(np.arange(len(count), dtype=np.float64) for count in counts)
    return Interval(value, *_bootstrap(numbers, mean, "BCa"), n)


def _bootstrap(
    samples: tuple[Array, ...], function: Callable[..., Any], method: str
) -> tuple[float, float]:
    """The ends of the interval; where BCa has none (all alike) those of the percentiles."""
    from scipy.stats import bootstrap

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of degenerate samples: seen by the NaN
        result = bootstrap(
            samples,
            function,
            n_resamples=RESAMPLES,
            confidence_level=LEVEL,
            method=method,
            vectorized=True,
            batch=max(1, MOST_NUMBERS // max(len(sample) for sample in samples)),
            rng=np.random.default_rng(SEED),
        )
    low, high = (float(end) for end in result.confidence_interval)
    if np.isfinite(low) and np.isfinite(high):
        return low, high
    tail = (1 - LEVEL) / 2
    low, high = np.nanquantile(result.bootstrap_distribution, [tail, 1 - tail])
    return float(low), float(high)


def relation_clusters(start: Array, end: Array, local: Mask) -> Labels:
    """A label (R,) for every relation: equal for those that belong to one place and time.

    A relation's place is where the robot was at its two ends, and two relations whose ends are
    seconds apart span the same loop: their errors are one event. Long relations: single linkage
    of (start, end), the earlier first, cut at ``PLACE_S`` in the larger of the two distances.
    Local relations: blocks of ``BLOCK_S`` by the middle, counted from the first relation's.
    Long ones get 0, 1, ..., local ones the numbers after, both in the order of time.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    labels = np.zeros(len(start), np.intp)
    ends = np.sort(np.column_stack([start, end]), axis=1)
    far = ends[~local]
    if len(far):
        pairs = cKDTree(far).query_pairs(PLACE_S, p=np.inf, output_type="ndarray")
        shape = (len(far), len(far))
        near = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=shape)
        components = connected_components(near, directed=False)[1]
        labels[~local] = _by_time(components, far)
    if local.any():
        middle = ends[local].mean(axis=1)
        block = np.floor((middle - middle.min()) / BLOCK_S).astype(np.intp)
        labels[local] = np.unique(block, return_inverse=True)[1] + labels.max() + int(len(far) > 0)
    return labels


def _by_time(labels: Labels, ends: Array) -> Labels:
    """The same clusters, numbered by their first (start, end) whatever the order of the rows."""
    in_time = labels[np.lexsort((ends[:, 1], ends[:, 0]))]
    first = np.unique(in_time, return_index=True)[1]
    return np.asarray(np.argsort(np.argsort(first))[labels], np.intp)


def signed_rank(differences: ArrayLike) -> float | None:
    """Two-sided p of the Wilcoxon signed-rank test of paired differences (n,).

    Pairs without a difference are dropped (Wilcoxon 1945). Exact, except for more than 50 pairs,
    or more than 13 with ties: then scipy's normal approximation. None for fewer than
    ``INDEPENDENT`` pairs, and if none differs at all: two names of the same thing are no test.
    """
    from scipy.stats import wilcoxon

    data = np.asarray(differences, np.float64)
    if len(data) < INDEPENDENT or not data.any():
        return None
    return float(wilcoxon(data[data != 0], method="auto").pvalue)


def holm(p: Sequence[float | None]) -> list[float | None]:
    """The p values adjusted for their number (Holm 1979); a None is no comparison."""
    known = sorted((value, i) for i, value in enumerate(p) if value is not None)
    adjusted: list[float | None] = [None] * len(p)
    largest = 0.0
    for rank, (value, i) in enumerate(known):
        largest = max(largest, min(1.0, (len(known) - rank) * value))
        adjusted[i] = largest
    return adjusted


def mean_ranks(values: Array) -> Array | None:
    """Mean rank (M,) of methods by their values (n, M) on n data sets, 1 for the smallest; equal
    ones share theirs. None for fewer than ``INDEPENDENT`` data sets."""
    from scipy.stats import rankdata

    if len(values) < INDEPENDENT:
        return None
    return np.asarray(rankdata(values, axis=1).mean(axis=0), np.float64)
