"""Where registrations start: the motion between two scans as it may be known beforehand."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.calibration.track import Track
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.geometry import inverse, se2, se3
from rbtm_bench.core.types import Array

GuessName = Literal["auto", "odometry", "constant_velocity", "identity", "truth"]
GUESSES: tuple[GuessName, ...] = ("auto", "odometry", "constant_velocity", "identity", "truth")

DESCRIPTIONS = {
    "odometry": "odometry between the two scans",
    "constant_velocity": "constant velocity: the true poses up to the scan before the new one, "
    "and its last true step again (identity where these are not known)",
    "identity": "identity: no motion",
    "truth": "the true motion",
}


def resolved(name: GuessName, track: Track, truth: str) -> GuessName:
    """The guess that ``auto`` stands for; else the one asked for.

    Raises ``ConfigError`` for one that the data set cannot give.
    """
    if name == "auto":
        if track.odometry is not None:
            return "odometry"
        return "constant_velocity" if truth == "poses" else "identity"
    if name == "odometry" and track.odometry is None:
        raise ConfigError("--guess odometry: this data set has no odometry")
    if name == "constant_velocity" and truth != "poses":
        raise ConfigError("--guess constant_velocity: needs a true pose a scan")
    return name


def motions(name: str, track: Track, target: NDArray[np.intp], source: NDArray[np.intp]) -> Array:
    """T_target_source (K, 4, 4) for pairs of scans (K,), by odometry, constant velocity or
    identity."""
    still = np.tile(np.eye(4), (len(target), 1, 1))
    if name == "odometry":
        assert track.odometry is not None
        return np.asarray(inverse(track.odometry[target]) @ track.odometry[source])
    if name == "constant_velocity":
        assert track.truth is not None
        before, earlier = np.maximum(source - 1, 0), np.maximum(source - 2, 0)
        step = inverse(track.truth[earlier]) @ track.truth[before]
        guess = inverse(track.truth[target]) @ track.truth[before] @ step
        known = np.isfinite(guess).all(axis=(1, 2)) & (source >= 2)
        return np.where(known[:, None, None], guess, still)
    return still


def disturbed(
    T: Array, metres: float, degrees: float, planar: bool, random: np.random.Generator
) -> Array:
    """Motions (K, 4, 4) with an error of this size in the source's frame: a translation (and, in
    space, an axis) in a random direction, a rotation to a random side."""
    if metres == 0.0 and degrees == 0.0:
        return T
    return np.array([one @ _error(metres, degrees, planar, random) for one in T]).reshape(-1, 4, 4)


def _error(metres: float, degrees: float, planar: bool, random: np.random.Generator) -> Array:
    angle = math.radians(degrees) * random.choice([-1.0, 1.0])
    if planar:
        way = random.uniform(-math.pi, math.pi)
        return se2(metres * math.cos(way), metres * math.sin(way), angle)
    from scipy.spatial.transform import Rotation

    direction, axis = (v / np.linalg.norm(v) for v in random.normal(size=(2, 3)))
    return se3(metres * direction, Rotation.from_rotvec(angle * axis).as_matrix())
