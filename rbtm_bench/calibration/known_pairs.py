"""Pairs of scans with a known motion between them, and how far backends end from it.

What benchmarks of backends are made of: no selection, no trajectory, one registration at a time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rbtm_bench.backends.base import Backend, Prepared
from rbtm_bench.calibration import guesses
from rbtm_bench.core.errors import BackendError, DataError
from rbtm_bench.core.geometry import inverse, rotation_angle, translation_norm
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.odometry import judge


@dataclass(frozen=True, eq=False)
class KnownPair:
    """Two scans and the motion (4, 4) between them, as exactly as it is known.

    ``odometry`` is the motion that the robot measured, None without odometry.
    """

    target: Scan
    source: Scan
    T_target_source: Array
    odometry: Array | None


@dataclass(frozen=True)
class PairOutcome:
    """How one registration ended: off by so many m and deg, in s; NaN where it raised."""

    metres: float
    degrees: float
    seconds: float
    iterations: int | None = None
    converged: bool | None = None
    reason: str = ""

    def within(self, metres: float, degrees: float) -> bool:
        """True if the result is at most this far from the truth."""
        return self.metres <= metres and self.degrees <= degrees


def pairs_of(dataset: Dataset, gap: int = 1, at_most: int | None = None) -> list[KnownPair]:
    """The pairs (i, i + gap) of a data set with ground truth, ``at_most`` spread over it evenly.

    Pairs without ground truth are left out. Raises ``DataError`` if none remains.
    """
    first = np.arange(max(0, len(dataset) - gap))
    if at_most is not None and len(first) > at_most:
        first = np.linspace(0, len(first) - 1, at_most).round().astype(np.int64)
    pairs, scans = [], {int(i): dataset[int(i)] for i in np.union1d(first, first + gap)}
    for i in first.tolist():
        target, source = scans[i], scans[i + gap]
        if target.ground_truth is None or source.ground_truth is None:
            continue
        T = inverse(target.ground_truth) @ source.ground_truth
        moved = None
        if target.odometry is not None and source.odometry is not None:
            moved = inverse(target.odometry) @ source.odometry
        pairs.append(KnownPair(target, source, T, moved))
    if not pairs:
        raise DataError(f"no two scans {gap} apart have ground truth")
    return pairs


def errors_of(T: Array, truth: Array) -> tuple[float, float]:
    """Translation (m) and absolute rotation (deg) between two motions."""
    E = inverse(truth) @ T
    return float(translation_norm(E)), math.degrees(float(rotation_angle(E)))


def register_all(
    backend: Backend, pairs: Sequence[KnownPair], guesses: Sequence[Array]
) -> Iterator[PairOutcome]:
    """The outcome of every pair from its guess (4, 4). A scan is prepared once for neighbours."""
    prepared: dict[int, Prepared] = {}
    for pair, guess in zip(pairs, guesses, strict=True):
        scans = {id(scan): scan for scan in (pair.source, pair.target)}
        prepared = {key: kept for key, kept in prepared.items() if key in scans}
        try:
            for key, scan in scans.items():
                if key not in prepared:
                    prepared[key] = backend.prepare(scan.without_truth())
            source, target = prepared[id(pair.source)], prepared[id(pair.target)]
            result = judge.register(backend, source, target, guess)
        except BackendError as error:
            yield PairOutcome(math.nan, math.nan, math.nan, reason=str(error))
            continue
        metres, degrees = errors_of(result.T_target_source, pair.T_target_source)
        yield PairOutcome(metres, degrees, result.seconds, result.iterations, result.converged)


def disturbed(pair: KnownPair, metres: float, degrees: float, random: np.random.Generator) -> Array:
    """The true motion with an error of this size: translation and (in space) the axis of rotation
    in a random direction, rotation to a random side."""
    T = pair.T_target_source[None]
    return guesses.disturbed(T, metres, degrees, pair.source.planar, random)[0]
