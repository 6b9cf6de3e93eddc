"""One motion out of several measured ones."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rbtm_bench.core.geometry import inverse, se2, se3
from rbtm_bench.graph.fused import fused
from rbtm_bench.graph.motions import small
from rbtm_bench.graph.optimise import optimise
from rbtm_bench.graph.pose_graph import PoseGraph


def test_by_hand() -> None:
    """1.0 m at 10 mm and 1.03 m at 20 mm: weights 4 and 1, so 1.006 m at 1 / sqrt(5) of 20 mm."""
    measured = np.stack([se2(1.0, 0, 0), se2(1.03, 0, 0)])
    covariances = np.stack([np.diag([s, s, 0, 0, 0, 0.01]) ** 2 for s in (0.01, 0.02)])
    T, covariance = fused(measured, covariances, True, 5.0)
    np.testing.assert_allclose(T, se2(1.006, 0, 0), atol=1e-9)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(0.02 / np.sqrt(5))
    assert np.sqrt(covariance[5, 5]) == pytest.approx(0.01 / np.sqrt(2))


@pytest.mark.parametrize("planar", [True, False])
def test_it_is_the_pose_graph_of_two_nodes(planar) -> None:
    rng = np.random.default_rng(2)
    true = (
        se2(1, 2, 0.5)
        if planar
        else se3([1, 2, 3], Rotation.from_rotvec([0.2, 1, 0.5]).as_matrix())
    )
    off = [rng.normal(0, 0.05, 3) for _ in range(8)]
    if planar:
        measured = np.stack([true @ se2(*o) for o in off[:4]])
    else:
        turns = Rotation.from_rotvec(np.array(off[4:])).as_matrix()
        measured = np.stack([true @ se3(o, R) for o, R in zip(off, turns, strict=False)])
    A = rng.normal(0, 1, (4, 6, 6))
    covariances = 0.01 * (A @ np.swapaxes(A, 1, 2) + np.eye(6))
    axes = [0, 1, 5] if planar else list(range(6))
    free = np.ix_(range(4), axes, axes)
    information = np.zeros((4, 6, 6))
    information[free] = np.linalg.inv(covariances[free])
    graph = PoseGraph(
        np.arange(2),
        np.stack([np.eye(4), measured[0]]),
        np.array([[0, 1]] * 4),
        measured,
        information,
        np.zeros(4, dtype=bool),
        planar,
    )
    reference = optimise(graph, None, tolerance=1e-14).graph.T_world_scan[1]
    T, _ = fused(measured, covariances, planar, 1e9)
    assert np.abs(small((inverse(reference) @ T)[None])).max() < 1e-6


def test_one_wrong_of_four_does_not_decide() -> None:
    measured = np.stack([se2(1 + o, 0, 0) for o in (0.0, 0.002, -0.002, 0.8)])
    covariances = np.tile(np.diag([0.01, 0.01, 0, 0, 0, 0.01]) ** 2, (4, 1, 1))
    for order in ([0, 1, 2, 3], [3, 2, 1, 0]):
        T, _ = fused(measured[order], covariances, True, 5.0)
        assert abs(T[0, 3] - 1.0) < 0.001
