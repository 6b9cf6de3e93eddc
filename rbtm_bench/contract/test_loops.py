"""What closes loops gives every scan a pose, counts what it did, and takes drift away."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.backends.plicp import PointToLineICP
from rbtm_bench.check.none import AcceptAll
from rbtm_bench.contract.members import Catalogue, Member
from rbtm_bench.contract.scene import planar_scan
from rbtm_bench.core.geometry import inverse, is_rigid, se2, translation_norm
from rbtm_bench.core.types import Array, Edge, Scan, Step, StepRecord
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.guess.identity import Identity
from rbtm_bench.loops.base import Closing, Loops, Route
from rbtm_bench.odometry.method import Method, Work
from rbtm_bench.selection.previous import Previous
from rbtm_bench.similarity.range_correlation import RangeCorrelation
from rbtm_bench.target.single import SingleScan

GROUP = "loops"
STEP = 0.4
DRIFT = se2(0.004, 0.0, np.radians(0.4))
"""What every measured step is off."""
UNSURE = np.diag([0.01, 0.01, 0.0, 0.0, 0.0, np.radians(0.6)]) ** 2


def round_and_round(count: int = 48) -> list[Array]:
    """Three times round a circle of 1 m in the middle of the room."""
    turns = STEP * np.arange(count)
    return [se2(0.8 + np.sin(t), 0.6 - np.cos(t), t) for t in turns]


class Seen(Dataset):
    """Scans of the room from known poses."""

    planar = has_beams = True

    def __init__(self, poses: list[Array]) -> None:
        self.poses = poses

    def __len__(self) -> int:
        return len(self.poses)

    def __getitem__(self, index: int) -> Scan:
        return planar_scan(self.poses[index], index, noise=0.005)

    def fingerprint(self) -> str:
        return "seen"


def route_of(poses: list[Array]) -> Route:
    """A chain of steps from scan to scan, each off by ``DRIFT``."""
    route, T = Route(), np.eye(4)
    for scan in range(len(poses)):
        edges: tuple[Edge, ...] = ()
        if scan:
            motion = inverse(poses[scan - 1]) @ poses[scan] @ DRIFT
            edges, T = (Edge(scan - 1, scan, motion, covariance=UNSURE),), T @ motion
        route.add(Step(StepRecord(scan, 0.1 * scan), edges, T))
    return route


def work() -> Work:
    """A planar method at work."""
    backend = PointToLineICP(max_correspondence_distance=0.3)
    similarity = RangeCorrelation(max_lag_deg=10.0)
    parts = similarity, Previous(), Identity(), AcceptAll(), SingleScan()
    return Work(Method(backend, *parts))


@pytest.fixture
def loops(catalogue: Catalogue, member: Member) -> Loops:
    """What is tested, new for every test."""
    loops: Loops = catalogue.build(member)
    return loops


def closed(loops: Loops, poses: list[Array]) -> Closing:
    closing = loops.close(route_of(poses), Seen(poses), work())
    if loops.is_off:
        assert closing is None, "is_off = True, and still loops are closed"
        pytest.skip("closes no loops")
    assert isinstance(closing, Closing), f"close() gave {type(closing).__name__}"
    return closing


def test_every_scan_has_a_pose(loops: Loops) -> None:
    poses = round_and_round()
    given = closed(loops, poses).T_world_scan
    assert given.shape == (len(poses), 4, 4), f"poses {given.shape}"
    for scan, T in enumerate(given):
        assert is_rigid(T) and T[2, 3] == 0.0, f"scan {scan}: no planar motion"
    assert np.array_equal(given[0], np.eye(4)), "the first pose is not held"


def test_what_it_counts_adds_up(loops: Loops) -> None:
    closing = closed(loops, round_and_round())
    assert closing.candidates == closing.accepted + closing.rejected
    assert 0 <= closing.turned_off <= closing.accepted
    assert closing.accepted == np.count_nonzero(closing.graph.may_be_wrong)
    assert closing.seconds > 0.0
    assert len(closing.graph.scans) == 48, "every scan is a node of the graph"


def test_drift_is_taken_away(loops: Loops) -> None:
    poses = round_and_round()
    closing, truth = closed(loops, poses), inverse(poses[0]) @ np.stack(poses)
    before = translation_norm(inverse(truth) @ np.stack(route_of(poses).T_world_scan))
    after = translation_norm(inverse(truth) @ closing.T_world_scan)
    assert closing.accepted > 0, "three times round the same circle, and no loop"
    assert after.max() < 0.5 * before.max(), (
        f"off by at most {before.max():.3f} m before and {after.max():.3f} m after"
    )


def test_a_short_path_stays_as_it_is(loops: Loops) -> None:
    poses = [se2(-2.0 + 0.3 * i, -1.0, 0.0) for i in range(12)]
    closing = closed(loops, poses)
    assert closing.accepted == 0, "a straight path of 3 m has no loops"
    apart = translation_norm(inverse(np.stack(route_of(poses).T_world_scan)) @ closing.T_world_scan)
    assert apart.max() < 1e-9, "no loop, and the poses have moved"


def test_two_times_the_same_bits(loops: Loops, catalogue: Catalogue, member: Member) -> None:
    poses = round_and_round()
    first, second = closed(loops, poses), closed(catalogue.build(member), poses)
    assert np.array_equal(first.T_world_scan, second.T_world_scan)


def test_what_it_is_handed_stays_as_it_was(loops: Loops) -> None:
    poses = round_and_round()
    route = route_of(poses)
    before = [T.tobytes() for T in (*route.T_world_scan, *(e.T_model_scan for e in route.edges))]
    loops.close(route, Seen(poses), work())
    after = [T.tobytes() for T in (*route.T_world_scan, *(e.T_model_scan for e in route.edges))]
    assert after == before, "close() modified the run's poses or edges"
