"""What to do where the scan cannot see the motion: keep the guess along those directions, wholly
(``remap``) or as far as the scan holds less than the guess (``fused``)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rbtm_bench.core.geometry import inverse, se2, se3, yaw
from rbtm_bench.core.types import Array, Localizability, RegistrationResult
from rbtm_bench.core.uncertainty import ODOMETRY_M, ODOMETRY_RAD, ODOMETRY_SHARE

MATCH_STD, MATCHES_PER_MEASUREMENT = 0.03, 10
"""What ``fused`` takes for granted; ``weight`` scales all of it."""


def remap(result: RegistrationResult, T_guess: Array, threshold: float) -> RegistrationResult:
    """Solution remapping (Zhang, Kaess and Singh 2016, eq. 13-15): the motion from the guess to
    the result loses its part along eigenvectors whose eigenvalue is below ``threshold``.

    The eigenvalues are those of ``Localizability``, shares in 0 ... 1 (the paper's are not
    normalised). Fitness and RMSE stay those of the registration. A result without localizability
    is kept as it is.
    """
    held = result.localizability
    if held is None:
        return result
    values, vectors = held.axes
    if not (values < threshold).any():
        return result
    kept = vectors[:, values >= threshold]
    planar, scale = _scale(held)
    moved = _vector(inverse(T_guess) @ result.T_target_source, planar) * scale
    seen = kept @ (kept.T @ moved) / scale
    return replace(result, T_target_source=T_guess @ _motion(seen, planar))


def fused(result: RegistrationResult, T_guess: Array, weight: float) -> RegistrationResult:
    """The registration and its guess, each by its information (a weak prior: ``weight`` of the
    guess's counts). Where the scan holds the motion the guess moves it by next to nothing; along
    a direction that it does not see, the guess stands.

    The guess is taken to be off by ``ODOMETRY_M`` m and ``ODOMETRY_SHARE`` of its distance, and
    by ``ODOMETRY_RAD`` rad and the same share of its turn; a match by ``MATCH_STD`` m, of which one
    in ``MATCHES_PER_MEASUREMENT`` counts, since neighbouring beams see the same surface.
    Fitness and RMSE stay those of the registration; without localizability it is kept as it is.
    """
    held = result.localizability
    if held is None:
        return result
    planar, scale = _scale(held)
    step = _vector(T_guess, planar)
    turns = slice(2, 3) if planar else slice(3, 6)
    std = np.full(len(scale), ODOMETRY_M + ODOMETRY_SHARE * float(np.linalg.norm(T_guess[:3, 3])))
    turn = ODOMETRY_RAD + ODOMETRY_SHARE * float(np.linalg.norm(step[turns]))
    std[turns] = turn * held.lever
    prior = np.diag(weight / std**2)
    measured = held.matrix * (result.inliers / (MATCHES_PER_MEASUREMENT * MATCH_STD**2))
    moved = _vector(inverse(T_guess) @ result.T_target_source, planar) * scale
    both = np.linalg.solve(measured + prior, measured @ moved) / scale
    return replace(result, T_target_source=T_guess @ _motion(both, planar))


def _scale(held: Localizability) -> tuple[bool, Array]:
    """Whether it is of the plane, and metres per unit of x, y, (z,) and the turns."""
    planar = len(held.matrix) == 3
    scale = np.ones(len(held.matrix))
    scale[2 if planar else slice(3, 6)] = held.lever
    return planar, scale


def unseen(result: RegistrationResult, threshold: float) -> int:
    """How many directions the scan holds less than ``threshold``."""
    held = result.localizability
    return 0 if held is None else int((held.axes[0] < threshold).sum())


def _vector(T: Array, planar: bool) -> Array:
    """x, y, rz, or x, y, z and the rotation vector."""
    if planar:
        return np.array([T[0, 3], T[1, 3], float(yaw(T))])
    from scipy.spatial.transform import Rotation

    return np.concatenate([T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_rotvec()])


def _motion(vector: Array, planar: bool) -> Array:
    """The motion of ``_vector``."""
    if planar:
        return se2(*(float(v) for v in vector))
    from scipy.spatial.transform import Rotation

    return se3(vector[:3], Rotation.from_rotvec(vector[3:]).as_matrix())
