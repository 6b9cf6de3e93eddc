"""How far a chain of registrations drifts: from the signed errors of pairs to the end of a path.

A gap of g scans takes n = N / g registrations over a path of N scans. With e the error of the
translation in the model's frame, s and b the standard deviation and mean of the error of the
heading, L the path's length, and errors that are independent of one another,

    drift^2 = |n mean e|^2 + n tr cov e + n s^2 L^2 / 3 + (n b L / 2)^2

on a straight path: the heading's error at one registration swings all that follows. On any other
path errors are drawn, whole blocks of neighbouring pairs together, and composed along it. Either
way the blocks are resampled for an interval. Pairs that failed are among them, with the guess's
error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.calibration.roc import percentiles, resampled
from rbtm_bench.core.geometry import inverse, rotation_angle, translation_norm
from rbtm_bench.core.types import Array
from rbtm_bench.report.intervals import SEED, Interval

STRAIGHT, STRAIGHT_DEG = 0.98, 10.0
"""A path whose ends are this share of its length apart, and whose ends point alike, is straight."""
OUTER, INNER = 100, 2
"""Resamples of the blocks, and chains drawn from each."""
SPREAD = 1.4826
"""A normal standard deviation in median absolute deviations."""


@dataclass(frozen=True, eq=False)
class PairErrors:
    """Errors of pairs in their models' frames: ``shift`` (K, 3) m, ``turn`` (K, 3) rad, ``block``
    (K,) what is resampled together, ``weight`` (K,) how often a chain has such a pair."""

    shift: Array
    turn: Array
    block: NDArray[np.intp]
    weight: Array

    @property
    def spread(self) -> tuple[float, float]:
        """Of shift (m) and turn (rad): robust, so that failures do not count."""
        mads = [
            np.median(np.abs(e - np.median(e, axis=0)), axis=0) for e in (self.shift, self.turn)
        ]
        m, rad = (SPREAD * float(np.linalg.norm(mad)) for mad in mads)
        return m, rad


def drift(errors: PairErrors, path: Array, gap: float) -> Interval:
    """Root mean square distance (m) between the end of a chain and that of the path (N, 4, 4), for
    registrations ``gap`` scans apart; ``n`` counts blocks. Seeded."""
    labels = np.unique(errors.block, return_inverse=True)[1]
    links = max(1, math.ceil((len(path) - 1) / gap))
    ends = inverse(path[0]) @ path[-1]
    length = float(translation_norm(inverse(path[:-1]) @ path[1:]).sum())
    apart = float(translation_norm(ends))
    if apart >= STRAIGHT * length and math.degrees(float(rotation_angle(ends))) < STRAIGHT_DEG:
        value, drawn = _straight(errors, labels, links, length)
    else:
        value, drawn = _composed(errors, labels, path, links)
    return Interval(value, *percentiles(drawn), int(labels.max()) + 1)


def straight_line(mean: Array, covariance: Array, links: float, length: float) -> float:
    """The formula above, of the mean (6,) and covariance (6, 6) of (shift, turn) along x."""
    bias, s2 = mean[4:], float(np.trace(covariance[4:, 4:]))  # what turns about y and z displaces
    squares = (
        float(np.sum((links * mean[:3]) ** 2)),
        links * float(np.trace(covariance[:3, :3])),
        links * s2 * length**2 / 3.0,
        float(np.sum((links * bias * length / 2.0) ** 2)),
    )
    return math.sqrt(sum(squares))


def noise_drift(spread: tuple[float, float], links: float, length: float, units: int) -> float:
    """What an error of the truth of this spread (m, rad) would look like after so many pairs: by
    itself, and by the mean that it leaves in so many independent ``units``."""
    m, rad = spread
    by_itself = links * (m**2 + rad**2 * length**2 / 3.0)
    return math.sqrt(by_itself + links**2 / units * (m**2 + rad**2 * length**2 / 4.0))


def _straight(
    errors: PairErrors, labels: NDArray[np.intp], links: int, length: float
) -> tuple[float, Array]:
    e = np.concatenate([errors.shift, errors.turn], axis=1)
    blocks = int(labels.max()) + 1
    sums, products = np.zeros((blocks, 6)), np.zeros((blocks, 6, 6))
    np.add.at(sums, labels, errors.weight[:, None] * e)
    np.add.at(products, labels, errors.weight[:, None, None] * e[:, :, None] * e[:, None])
    total = np.bincount(labels, errors.weight)

    def of(times: Array) -> float:
        W = float(times @ total)
        mean = times @ sums / W
        second = np.tensordot(times, products, 1) / W
        return straight_line(mean, second - np.outer(mean, mean), links, length)

    return of(np.ones(blocks)), np.array([of(times) for times in resampled(blocks, OUTER)])


def _composed(
    errors: PairErrors, labels: NDArray[np.intp], path: Array, links: int
) -> tuple[float, Array]:
    from scipy.spatial.transform import Rotation

    at = np.linspace(0, len(path) - 1, links + 1).round().astype(np.intp)
    steps = inverse(path[at[:-1]]) @ path[at[1:]]
    chosen = _chains(errors, labels, links)
    turns = Rotation.from_rotvec(errors.turn).as_matrix()
    X = np.tile(np.eye(4), (len(chosen), 1, 1))
    for k, step in enumerate(steps):
        T = np.tile(step, (len(chosen), 1, 1))
        T[:, :3, :3] = turns[chosen[:, k]] @ step[:3, :3]
        T[:, :3, 3] += errors.shift[chosen[:, k]]
        X = X @ T
    true_end = inverse(path[0]) @ path[at[-1]]
    squares = ((X[:, :3, 3] - true_end[:3, 3]) ** 2).sum(axis=1).reshape(-1, INNER)
    return math.sqrt(float(squares.mean())), np.sqrt(squares.mean(axis=1))


def _chains(errors: PairErrors, labels: NDArray[np.intp], links: int) -> NDArray[np.intp]:
    """Which pairs (OUTER x INNER, links) follow one another: block by block, of a block those that
    its weights keep, in their order."""
    rng = np.random.default_rng(SEED)
    count = int(labels.max()) + 1
    members = [np.flatnonzero(labels == b) for b in range(count)]
    keep = [errors.weight[m] / errors.weight[m].max() for m in members]
    share = np.array([errors.weight[m].max() for m in members])
    chains = []
    for times in np.repeat(resampled(count, OUTER), INNER, axis=0):
        p = times * share
        drawn: list[NDArray[np.intp]] = []
        have = 0
        while have < links:
            for b in rng.choice(count, 16, p=p / p.sum()):
                drawn.append(members[b][rng.random(len(keep[b])) < keep[b]])
                have += len(drawn[-1])
        chains.append(np.concatenate(drawn)[:links])
    return np.stack(chains)
