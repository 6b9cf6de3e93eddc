"""What to do where the scan cannot see the motion: keep the guess along those directions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rbtm_bench.core.geometry import inverse, se2, se3, yaw
from rbtm_bench.core.types import Array, RegistrationResult


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
    planar = len(values) == 3
    scale = np.ones(len(values))
    scale[2 if planar else slice(3, 6)] = held.lever
    moved = _vector(inverse(T_guess) @ result.T_target_source, planar) * scale
    seen = kept @ (kept.T @ moved) / scale
    return replace(result, T_target_source=T_guess @ _motion(seen, planar))


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
