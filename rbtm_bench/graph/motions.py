"""Small motions of many poses at once: how they are applied, read off, and what they do to an edge.

A small motion d = (x, y, z, rx, ry, rz), in m and rad in a pose's own frame, moves the pose T by
the translation (x, y, z) and the rotation vector (rx, ry, rz); to first order that is T exp(d). In
the plane z, rx and ry are 0. The closed forms are those of Barfoot, "State Estimation for
Robotics" (2017), section 7.1.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array

SMALL = 1e-4
"""rad, below which series stand for quotients of what vanishes."""


def moved(T: Array, d: Array) -> Array:
    """Poses (N, 4, 4), each moved by its small motion (N, 6)."""
    out = T.copy()
    out[:, :3, 3] += (T[:, :3, :3] @ d[:, :3, None])[..., 0]
    out[:, :3, :3] = T[:, :3, :3] @ Rotation.from_rotvec(d[:, 3:]).as_matrix()
    return out


def small(T: Array) -> Array:
    """The small motions (N, 6) that move the identity to the poses (N, 4, 4)."""
    return np.hstack([T[:, :3, 3], Rotation.from_matrix(T[:, :3, :3]).as_rotvec()])


def residuals(T_world_model: Array, T_world_scan: Array, T_model_scan: Array) -> Array:
    """What edges (E, 4, 4) are off from the poses of their ends: the small motions e (E, 6) of the
    scan in its own frame, T_model_scan moved by e = inverse(T_world_model) T_world_scan."""
    return small(inverse(T_model_scan) @ inverse(T_world_model) @ T_world_scan)


def jacobians(T_model_scan: Array, e: Array) -> tuple[Array, Array]:
    """The derivatives (E, 6, 6) of ``residuals`` e (E, 6) by small motions of the model and of the
    scan, each in its own frame, at no motion."""
    R_e, zero = Rotation.from_rotvec(e[:, 3:]).as_matrix(), np.zeros((len(e), 6, 6))
    by_model, by_scan = zero, zero.copy()
    by_scan[:, :3, :3] = R_e
    by_scan[:, 3:, 3:] = _right_inverse(e[:, 3:])
    # the model's motion d acts from the left: exp(-Ad(T_scan_model) d) before what is off
    by_model[:, :3, :3] = np.eye(3)
    by_model[:, :3, 3:] = -_cross(e[:, :3])
    by_model[:, 3:, 3:] = _right_inverse(-e[:, 3:])
    return -by_model @ _adjoints(inverse(T_model_scan)), by_scan


def _adjoints(T: Array) -> Array:
    """``geometry.adjoint`` of many (E, 6, 6)."""
    R, out = T[:, :3, :3], np.zeros((len(T), 6, 6))
    out[:, :3, :3] = out[:, 3:, 3:] = R
    out[:, :3, 3:] = _cross(T[:, :3, 3]) @ R
    return out


def _cross(v: Array) -> Array:
    """The matrices (E, 3, 3) of cross products with the vectors (E, 3)."""
    out = np.zeros((len(v), 3, 3))
    x, y, z = v.T
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -z, y, -x
    return out - np.swapaxes(out, 1, 2)


def _right_inverse(r: Array) -> Array:
    """The inverse right Jacobians (E, 3, 3) of SO(3): log(exp(r) exp(d)) = r + J d."""
    angle = np.linalg.norm(r, axis=1)
    safe = np.where(angle < SMALL, 1.0, angle)
    exact = 1.0 / safe**2 - (1.0 + np.cos(safe)) / (2.0 * safe * np.sin(safe))
    factor = np.where(angle < SMALL, 1.0 / 12.0 + angle**2 / 720.0, exact)
    K = _cross(r)
    return np.eye(3) + 0.5 * K + factor[:, None, None] * (K @ K)
