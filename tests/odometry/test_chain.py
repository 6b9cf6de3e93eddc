"""Chaining edges into poses."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rbtm_bench.core.errors import RunError
from rbtm_bench.core.geometry import is_rigid, se2, se3
from rbtm_bench.core.types import Edge
from rbtm_bench.odometry.chain import PoseChain


def test_poses_follow_from_edges_by_hand():
    chain = PoseChain()
    assert np.array_equal(chain.start(1), np.eye(4))
    chain.add(Edge(model=1, scan=2, T_model_scan=se2(1, 0, np.pi / 2)))
    # The path of the paper's example: 1 -> 2 -> 4, while 3 hangs on 1.
    chain.add(Edge(model=1, scan=3, T_model_scan=se2(5, 0, 0)))
    T = chain.add(Edge(model=2, scan=4, T_model_scan=se2(2, 0, 0)))
    assert np.allclose(T, se2(1, 2, np.pi / 2), atol=1e-12)
    assert chain.pose(4) is T
    assert np.allclose(chain.pose(3), se2(5, 0, 0))
    assert len(chain) == 4
    assert 3 in chain and 5 not in chain


def test_the_first_pose_can_be_anywhere():
    chain = PoseChain()
    chain.start(7, se2(1, 2, np.pi))
    T = chain.add(Edge(model=7, scan=8, T_model_scan=se2(1, 0, 0)))
    assert np.allclose(T, se2(0, 2, np.pi), atol=1e-12)


def test_errors_name_the_scans():
    chain = PoseChain()
    with pytest.raises(RunError, match="model scan 0 to scan 1: scan 0 has no pose"):
        chain.add(Edge(0, 1, np.eye(4)))
    with pytest.raises(RunError, match="scan 0 has no pose"):
        chain.pose(0)
    with pytest.raises(RunError, match="of scan 0, is not a rigid motion"):
        chain.start(0, np.zeros((4, 4)))
    chain.start(0)
    with pytest.raises(RunError, match="already started"):
        chain.start(1)
    with pytest.raises(RunError, match="model scan 0 to scan 0: scan 0 already has a pose"):
        chain.add(Edge(0, 0, np.eye(4)))
    for fault in (np.full((4, 4), np.nan), np.diag([1.1, 1.0, 1.0, 1.0]), np.eye(3)):
        with pytest.raises(RunError, match="model scan 0 to scan 1: its motion is not rigid"):
            chain.add(Edge(0, 1, fault))
    assert len(chain) == 1


def test_poses_cannot_be_changed_by_who_gets_them():
    start = np.eye(4)
    chain = PoseChain()
    T = chain.start(0, start)
    with pytest.raises(ValueError, match="read-only"):
        T[0, 3] = 1.0
    start[0, 3] = 1.0
    assert chain.pose(0)[0, 3] == 0.0


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_a_hundred_thousand_edges_keep_poses_rigid(dtype):
    """Edges of a library in single precision are off by 1e-7 each, and always the same way."""
    motion = se3([0.1, 0.01, 0.0], Rotation.from_rotvec([0.01, 0.02, 0.03]).as_matrix())
    motion = motion.astype(dtype).astype(np.float64)
    chain, plain = PoseChain(), np.eye(4)
    T = chain.start(0)
    for i in range(100_000):
        T = chain.add(Edge(i, i + 1, motion))
        plain = plain @ motion
    assert is_rigid(T, tolerance=1e-12)
    if dtype is np.float32:
        assert not is_rigid(plain)  # what the correction is for
    else:
        assert np.abs(T - plain).max() < 1e-8


def test_an_edge_that_is_slightly_off_is_put_right():
    rough = se2(1, 0, 0.5)
    rough[0, 0] += 3e-5
    assert not is_rigid(rough)
    chain = PoseChain()
    chain.start(0)
    assert is_rigid(chain.add(Edge(0, 1, rough)), tolerance=1e-8)


def test_a_planar_chain_stays_exactly_in_the_plane():
    chain = PoseChain()
    T = chain.start(0)
    for i in range(1000):
        T = chain.add(Edge(i, i + 1, se2(0.3, 0.1, 0.7)))
    assert np.array_equal(T[2], [0, 0, 1, 0])
    assert np.array_equal(T[:, 2], [0, 0, 1, 0])
