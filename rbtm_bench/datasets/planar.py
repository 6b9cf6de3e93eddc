"""Planar poses (..., 3): x, y in m and theta in rad."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.types import Array


def wrap(angle: Array) -> Array:
    """Angles (rad) in [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def planar_poses(poses: Array) -> Array:
    """4x4 poses (S, 4, 4) of planar poses (S, 3): x, y in m and theta in rad."""
    T = np.tile(np.eye(4), (len(poses), 1, 1))
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    T[:, 0, 0], T[:, 0, 1], T[:, 1, 0], T[:, 1, 1] = c, -s, s, c
    T[:, :2, 3] = poses[:, :2]
    return T


def compose(poses: Array, steps: Array) -> Array:
    """Where ``steps`` (..., 3), each in the frame of its pose, lead from ``poses`` (..., 3)."""
    c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    x, y = steps[..., 0], steps[..., 1]
    moved = [poses[..., 0] + c * x - s * y, poses[..., 1] + s * x + c * y]
    return np.stack([*moved, poses[..., 2] + steps[..., 2]], axis=-1)


def between(poses: Array, others: Array) -> Array:
    """The steps (..., 3) from ``poses`` to ``others``, in the frames of ``poses``."""
    c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    x, y = others[..., 0] - poses[..., 0], others[..., 1] - poses[..., 1]
    return np.stack([c * x + s * y, c * y - s * x, wrap(others[..., 2] - poses[..., 2])], axis=-1)


def moved(poses: Array, distance: float, angle: float) -> NDArray[np.int64]:
    """Indices of the poses (S, 3) to keep: the first, and each that moved far enough from the last.

    Far enough is ``distance`` (m) or ``angle`` (rad), whichever comes first; 0 turns one off.
    """
    distance, angle = distance or np.inf, angle or np.inf
    kept = [0]
    x, y, theta = poses[0]
    for index, (px, py, ptheta) in enumerate(poses):
        far = np.hypot(px - x, py - y) >= distance
        if far or abs((ptheta - theta + np.pi) % (2 * np.pi) - np.pi) >= angle:
            kept.append(index)
            x, y, theta = px, py, ptheta
    return np.array(kept)
