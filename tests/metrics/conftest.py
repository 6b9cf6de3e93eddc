"""Small trajectories for the metric tests."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rbtm_bench.core.geometry import se2
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array

Planar = Callable[[Sequence[tuple[float, float, float]]], Trajectory]
Wander = Callable[..., Trajectory]


@pytest.fixture
def planar() -> Planar:
    """A trajectory from (x, y in m, theta in deg), one pose a second."""

    def make(poses: Sequence[tuple[float, float, float]]) -> Trajectory:
        T = np.array([se2(x, y, np.radians(theta)) for x, y, theta in poses]).reshape(-1, 4, 4)
        return Trajectory(np.arange(len(poses), dtype=float), T)

    return make


@pytest.fixture
def wander() -> Wander:
    """A random walk of n poses in space (or in the plane), one pose a second."""

    def make(n: int, seed: int, flat: bool = False) -> Trajectory:
        rng = np.random.default_rng(seed)
        T: Array = np.tile(np.eye(4), (n, 1, 1))
        turns = rng.normal(scale=0.2, size=(n, 3)).cumsum(axis=0)
        steps = rng.normal(loc=0.3, scale=0.2, size=(n, 3)).cumsum(axis=0)
        if flat:
            turns[:, :2], steps[:, 2] = 0.0, 0.0
        T[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix()
        T[:, :3, 3] = steps
        return Trajectory(np.arange(n, dtype=float), T)

    return make
