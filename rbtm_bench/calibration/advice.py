"""Which threshold and window RBTM should have for a wanted rate of successful registrations.

RBTM registers to the oldest scan of its window whose score exceeds the threshold. Of the scans that
the sample's windows offer it is known which one that would be, hence how often which gap would be
chosen; and of the registered pairs, how often a pair of that gap with such a score succeeds. The
two together give the success rate of a setting. It promises that rate less one standard error (as
in Breiman et al. 1984): the best of hundreds of settings is a lucky one. Of the settings that
promise the wanted rate the one that reaches back farthest is advised: fewest registrations between
a scan and the start, which is what RBTM is for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.calibration.rates import Rate, rate
from rbtm_bench.core.types import Array

STEP = 0.02
"""Between the thresholds that are tried."""
FEWEST_PASSING = 30
"""Pairs of a gap above the threshold without which its success is not known."""
FEWEST_SHARE = 1 / 3
"""Nor is it if they come from less than this share of the part's blocks: from one place."""
LEAST_USE = 0.05
"""A setting must choose for at least this share of the scans, else it is the fallback's success."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a part of the data says of one backend and similarity.

    ``score``, ``success``, ``group``, ``cluster`` (K,) of the registered pairs; ``offered`` (A, G)
    the scores that A scans have with the scans G groups of gaps back, NaN where undefined, groups
    ``groups`` (G,) from small to large.
    """

    score: Array
    success: NDArray[np.bool_]
    group: NDArray[np.intp]
    cluster: NDArray[np.intp]
    offered: Array
    groups: NDArray[np.intp]


@dataclass(frozen=True)
class Promise:
    """What a setting does on a part: ``success`` of the pairs it chooses, ``used`` the share of
    scans that it chooses for, ``reach`` the mean gap of all scans (the fallback's is 1), ``pairs``
    registered pairs above the threshold, of the gaps it chooses. ``success`` is None where too few
    pairs are known."""

    threshold: float
    window: int
    success: Rate | None
    used: float
    reach: float
    pairs: int
    all_pass: bool = False
    """Every scan that the window offers passes: the threshold does nothing."""


@dataclass(frozen=True)
class Advice:
    """The setting chosen on the calibration part, and what it did on the reported part.

    ``reached``: the calibration part promises the wanted rate, less one standard error. ``chosen``
    and ``reported`` are None where nothing can be advised; ``why`` says so in words.
    ``previous``: the success on the reported part of the smallest gap that has pairs enough.
    """

    wanted: float
    reached: bool
    why: str
    chosen: Promise | None = None
    reported: Promise | None = None
    previous: Rate | None = None
    tried: int = 0


def advise(calibration: Evidence, reported: Evidence, wanted: float) -> Advice:
    """The setting that reaches back farthest of those that promise the wanted success; if none
    does, the one that promises most."""
    tried = [
        promise(calibration, float(threshold), int(group) + 1)
        for threshold in thresholds(calibration.score)
        for group in calibration.groups
    ]
    known = [p for p in tried if p.success is not None and p.used >= LEAST_USE]
    enough = [p for p in known if _rate(p) >= wanted]
    if not known:
        few = f"no gap has {FEWEST_PASSING} pairs, from a third of the part's blocks, that pass"
        return Advice(wanted, False, f"no advice: {few}")
    # of equal settings the higher threshold and the smaller window: the more cautious
    if enough:
        best = max(enough, key=lambda p: (round(p.reach, 6), _rate(p), p.threshold, -p.window))
    else:
        best = max(known, key=lambda p: (_rate(p), p.reach, p.threshold, -p.window))
    least_gap = [g for g in reported.groups if (reported.group == g).sum() >= FEWEST_PASSING][:1]
    smallest = np.isin(reported.group, least_gap)
    previous = rate(reported.success[smallest], reported.cluster[smallest])
    again = promise(reported, best.threshold, best.window, least=1)
    why = _why(bool(enough), best, wanted)
    return Advice(wanted, bool(enough), why, best, again, previous, len(tried))


def _rate(p: Promise) -> float:
    return p.success.cautious if p.success is not None else -1.0


def _why(reached: bool, best: Promise, wanted: float) -> str:
    if reached:
        return "promised by the calibration part"
    return (
        f"no threshold and window promise {wanted:.0%}; the best promise {_rate(best):.0%} "
        "(success less one standard error)"
    )


def thresholds(score: Array) -> Array:
    """Round numbers that cover the scores (K,), a step below the lowest included."""
    defined = score[np.isfinite(score)]
    if len(defined) == 0:
        return np.zeros(0)
    low, high = np.floor(defined.min() / STEP) - 1, np.ceil(defined.max() / STEP)
    return np.round(STEP * np.arange(max(low, -1 / STEP), high + 1), 6)


def promise(
    evidence: Evidence, threshold: float, window: int, least: int = FEWEST_PASSING
) -> Promise:
    """What RBTM with this setting would do, by the evidence.

    The success of a gap with fewer than ``least`` pairs above the threshold, or with pairs from
    less than a third of the blocks, is not known; a setting that would choose such gaps for more
    than one in ten of its choices promises nothing.
    """
    inside = evidence.groups < window
    choice = choices(evidence.offered, threshold, inside)
    chosen = np.bincount(choice[choice >= 0], minlength=len(inside)).astype(np.float64)
    used = float(np.mean(choice >= 0)) if len(choice) else 0.0
    reach = float(np.where(choice >= 0, evidence.groups[choice], 1).mean()) if used else 0.0
    all_pass = bool(used and (evidence.offered[:, inside] > threshold).all())
    above = evidence.score > threshold
    members = [above & (evidence.group == g) for g in evidence.groups]
    pairs = np.array([int(m.sum()) for m in members])
    blocks = np.array([len(np.unique(evidence.cluster[m])) for m in members])
    every = len(np.unique(evidence.cluster)) if least == FEWEST_PASSING else 0
    known = (pairs >= least) & (blocks >= FEWEST_SHARE * every)
    total = chosen.sum()
    if total == 0 or chosen[known].sum() < 0.9 * total:
        return Promise(threshold, window, None, used, reach, int(pairs[inside].sum()), all_pass)
    share = dict(
        zip(evidence.groups, np.where(known, chosen / np.maximum(pairs, 1), 0), strict=True)
    )
    weights = np.array([share.get(g, 0.0) for g in evidence.group]) * above
    success = rate(evidence.success, evidence.cluster, weights)
    return Promise(threshold, window, success, used, reach, success.n, all_pass)


def choices(offered: Array, threshold: float, inside: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Which group (A,) RBTM takes of those that the window holds: the oldest whose score (A, G)
    exceeds the threshold; -1 for none. An undefined score passes nothing."""
    passes = np.asarray((offered > threshold) & inside, bool)
    if passes.size == 0:
        return np.full(len(offered), -1)
    oldest = passes.shape[1] - 1 - np.argmax(passes[:, ::-1], axis=1)
    return np.asarray(np.where(passes.any(axis=1), oldest, -1), np.intp)
