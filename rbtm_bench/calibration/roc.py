"""How well a number that is known beforehand predicts whether a registration succeeds.

The area under the ROC curve is the share of (success, failure) couples in which the success has
the higher score, ties counting half (Mann and Whitney 1947; Hanley and McNeil 1982): 0.5 is chance.
At equal gap, only couples of one group of gaps are compared, so nothing is won by telling small
gaps from large ones. Intervals resample blocks of neighbouring pairs, not pairs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rbtm_bench.core.types import Array
from rbtm_bench.report.intervals import FEWEST_UNITS, LEVEL, SEED

RESAMPLES = 2000


@dataclass(frozen=True, eq=False)
class Area:
    """An area with its interval (None: fewer than three blocks), the successes and failures it is
    made of, and of the resamples ``drawn`` (B,), NaN where one had no couple. ``value`` is NaN
    without a couple at all."""

    value: float
    low: float | None
    high: float | None
    successes: int
    failures: int
    blocks: int
    couples: int
    drawn: Array

    def minus(self, other: Area) -> tuple[float, float | None, float | None]:
        """The difference of two areas of the same pairs, with its interval (paired resamples)."""
        return (self.value - other.value, *percentiles(self.drawn - other.drawn))


def area(
    scores: ArrayLike,
    success: ArrayLike,
    clusters: ArrayLike,
    strata: ArrayLike | None = None,
) -> Area:
    """The area of scores (K,) for successes (K,) bool; larger scores should mean success.

    An undefined score (NaN) counts as lower than every other, as a selector takes it, and two of
    them as equal. ``clusters`` (K,) are resampled together; couples are compared within a stratum
    (K,) only.
    """
    s = np.asarray(scores, np.float64)
    s = np.where(np.isnan(s), -np.inf, s)
    good = np.asarray(success, bool)
    labels = np.unique(np.asarray(clusters), return_inverse=True)[1]
    kinds = np.zeros(len(s), np.intp) if strata is None else np.asarray(strata)
    blocks = int(labels.max(initial=-1)) + 1
    won, all_couples = np.zeros((2, blocks, blocks))
    for kind in np.unique(kinds):
        up, down = np.flatnonzero(good & (kinds == kind)), np.flatnonzero(~good & (kinds == kind))
        if len(up) == 0 or len(down) == 0:
            continue
        higher = (s[up][:, None] > s[down]) + 0.5 * (s[up][:, None] == s[down])
        member_up = (labels[up] == np.arange(blocks)[:, None]).astype(np.float64)
        member_down = (labels[down] == np.arange(blocks)[:, None]).astype(np.float64)
        won += member_up @ higher @ member_down.T
        all_couples += np.outer(member_up.sum(axis=1), member_down.sum(axis=1))
    couples = float(all_couples.sum())
    value = float(won.sum() / couples) if couples else float("nan")
    drawn = np.full(RESAMPLES, np.nan)
    if blocks >= FEWEST_UNITS and couples:
        times = resampled(blocks)
        total = np.einsum("bi,ij,bj->b", times, all_couples, times, optimize=True)
        some = total > 0
        part = np.einsum("bi,ij,bj->b", times, won, times, optimize=True)
        drawn[some] = part[some] / total[some]
    low, high = percentiles(drawn)
    up_count = int(good.sum())
    return Area(value, low, high, up_count, len(good) - up_count, blocks, int(couples), drawn)


def resampled(blocks: int, resamples: int = RESAMPLES) -> Array:
    """How often (B, blocks) each block is drawn; the same for every score of the same pairs."""
    random = np.random.default_rng(SEED)
    each = np.full(blocks, 1.0 / blocks)
    return random.multinomial(blocks, each, size=resamples).astype(np.float64)


def percentiles(drawn: Array) -> tuple[float | None, float | None]:
    """The percentile interval of resamples; None where fewer than nine of ten have a value."""
    finite = drawn[np.isfinite(drawn)]
    if len(finite) < 0.9 * len(drawn) or len(finite) == 0:
        return None, None
    tail = (1 - LEVEL) / 2
    low, high = np.quantile(finite, [tail, 1 - tail])
    return float(low), float(high)


def ranks_within(scores: ArrayLike, strata: Sequence[int] | NDArray[np.intp]) -> Array:
    """The mid-rank (K,) of every score among those of its stratum, as a share from 0 to 1; NaN for
    an undefined one."""
    from scipy.stats import rankdata

    s, kinds = np.asarray(scores, np.float64), np.asarray(strata)
    out = np.full(len(s), np.nan)
    for kind in np.unique(kinds):
        inside = np.flatnonzero((kinds == kind) & np.isfinite(s))
        out[inside] = (rankdata(s[inside]) - 0.5) / max(1, len(inside))
    return out
