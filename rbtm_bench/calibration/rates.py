"""Success rates and error quantiles over similarity, with bands that know of neighbours."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rbtm_bench.core.types import Array
from rbtm_bench.report.intervals import LEVEL

QUANTILES = (0.5, 0.75, 0.9, 0.95)
"""Of errors; a failed registration counts as an infinite error."""
BINS = 8
"""Bins of similarity, each with equally many pairs."""


@dataclass(frozen=True)
class Rate:
    """A share of ``n`` pairs with its interval; ``effective`` independent pairs tell as much."""

    value: float
    low: float
    high: float
    n: int
    blocks: int
    effective: float


def rate(success: ArrayLike, clusters: ArrayLike) -> Rate:
    """The share of successes (K,), with Wilson's interval (1927) at the effective number of pairs
    (Korn and Graubard 1998): the number of independent ones that would vary as much as the blocks
    do, never more than all, and at most the number of blocks where all pairs agree.

    NaN and [0, 1] for no pairs.
    """
    good = np.asarray(success, np.float64)
    if len(good) == 0:
        return Rate(math.nan, 0.0, 1.0, 0, 0, 0.0)
    labels = np.unique(np.asarray(clusters), return_inverse=True)[1]
    blocks, n = int(labels.max()) + 1, len(good)
    p = float(good.mean())
    effective = float(min(n, blocks))
    if 0.0 < p < 1.0 and blocks > 1:
        off = np.bincount(labels, weights=good - p) / n
        variance = blocks / (blocks - 1) * float((off**2).sum())
        effective = min(n, p * (1 - p) / variance) if variance > 0 else float(n)
    low, high = wilson(p, effective)
    return Rate(p, low, high, n, blocks, effective)


def wilson(p: float, n: float) -> tuple[float, float]:
    """Wilson's 95 % score interval for a share ``p`` of ``n``, which need not be a whole number."""
    from scipy.stats import norm

    z = float(norm.ppf(0.5 + LEVEL / 2))
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return max(0.0, middle - half), min(1.0, middle + half)


def bins_of(scores: Array, count: int = BINS) -> Iterator[tuple[float, float, NDArray[np.intp]]]:
    """At most ``count`` bins (low, high, members) of equally many defined scores, ends included;
    equal scores stay together. Fewer bins where they would hold fewer than five."""
    known = np.flatnonzero(np.isfinite(scores))
    count = max(1, min(count, len(known) // 5))
    edges: Any = (
        np.unique(np.quantile(scores[known], np.linspace(0, 1, count + 1))) if len(known) else []
    )
    if len(edges) == 1:
        yield float(edges[0]), float(edges[0]), known
    for k in range(len(edges) - 1):
        above = scores[known] >= edges[k]
        below = (
            scores[known] <= edges[k + 1] if k == len(edges) - 2 else scores[known] < edges[k + 1]
        )
        members = known[above & below]
        if len(members):
            yield float(edges[k]), float(edges[k + 1]), members


def quantiles(errors: ArrayLike) -> list[float]:
    """``QUANTILES`` of errors, those of failed registrations (NaN) taken as infinite."""
    e = np.asarray(errors, np.float64)
    if len(e) == 0:
        return [math.nan] * len(QUANTILES)
    e = np.where(np.isnan(e), np.inf, e)
    return [float(q) for q in np.quantile(e, QUANTILES, method="inverted_cdf")]
