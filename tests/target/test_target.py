"""What a scan is registered to: one scan, or a small map around it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rbtm_bench.backends.base import Alignment, Backend, Prepared
from rbtm_bench.core.geometry import inverse, se2, transform
from rbtm_bench.core.types import Array, Node, Scan
from rbtm_bench.selection.window import Window
from rbtm_bench.target.local_map import LocalMap
from rbtm_bench.target.single import SingleScan

WORLD = np.random.default_rng(0).uniform(-5.0, 5.0, (30, 3)) * [1, 1, 0]


class Plain(Backend):
    """Builds nothing, and counts how often."""

    built = 0

    def build(self, points: Array, planar: bool) -> Any:
        self.built += 1
        return None

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        raise NotImplementedError


def pose(scan: int) -> Array:
    return se2(0.3 * scan, -0.1 * scan, 0.2 * scan)


def window_of(scans: range, capacity: int = 10, drift: float = 0.0) -> Window:
    """Each scan sees its own three points of the world from its estimated pose."""
    window = Window(capacity)
    for scan in scans:
        estimate = pose(scan) @ se2(0, drift * scan, 0)
        points = transform(inverse(estimate), WORLD[3 * scan : 3 * scan + 3])
        prepared = Prepared(points, True, None)
        window.push(Node(scan, 0.0, estimate, prepared=prepared))
    return window


def seen_from(model: int, scans: range) -> Array:
    """The world's points of these scans in the frame of the model scan."""
    return transform(inverse(pose(model)), WORLD[3 * scans[0] : 3 * scans[-1] + 3])


def test_a_single_scan_is_the_model_as_prepared() -> None:
    backend = Plain()
    window = window_of(range(6))
    assert SingleScan().build(3, window, backend) is window.node(3).prepared
    assert backend.built == 0


@pytest.mark.parametrize(
    ("model", "neighbours", "members"),
    [
        (4, 1, range(3, 6)),
        (4, 2, range(2, 7)),
        (0, 2, range(0, 3)),  # the window's oldest has neighbours on one side only
        (8, 2, range(6, 9)),  # and so has its newest
        (1, 3, range(0, 5)),
        (4, 50, range(0, 9)),
    ],
)
def test_a_local_map_is_the_world_around_the_model(model, neighbours, members) -> None:
    """Where the estimates are right the merged points are the world's, in the model's frame."""
    backend = Plain()
    target = LocalMap(neighbours).build(model, window_of(range(9)), backend)
    np.testing.assert_allclose(target.points, seen_from(model, members), atol=1e-12)
    assert target.planar


def test_it_is_placed_by_the_estimates() -> None:
    """Estimates that drift sideways by 5 cm a scan: a point seen by scan 4 lies as much off in
    the frame of scan 3 as the estimates say."""
    backend = Plain()
    window = window_of(range(9))
    drifting = Window(10)
    for node in window.nodes:
        drifted = node.T_world_scan @ se2(0, 0.05 * node.scan, 0)
        drifting.push(Node(node.scan, 0.0, drifted, prepared=node.prepared))
    points = LocalMap(1).build(3, drifting, backend).points
    T_3_4 = inverse(drifting.node(3).T_world_scan) @ drifting.node(4).T_world_scan
    np.testing.assert_allclose(points[3:6], drifting.node(3).prepared.points, atol=1e-12)
    np.testing.assert_allclose(
        points[6:9], transform(T_3_4, drifting.node(4).prepared.points), atol=1e-12
    )
    assert np.abs(points - seen_from(3, range(2, 5)))[6:9].max() > 0.03


def test_the_map_is_built_by_the_backend() -> None:
    """Through ``Backend.merge``: thinned and prepared as any scan is."""
    backend = Plain(voxel_size=100.0)
    window = Window(4)
    for scan in range(3):
        points = np.random.default_rng(scan).uniform(1.0, 2.0, (8, 3))
        points = np.concatenate([points, -points, points * [1, -1, 1], points * [-1, 1, 1]])
        points = np.concatenate([points, points * [1, 1, -1]])
        window.push(Node(scan, 0.0, np.eye(4), prepared=Prepared(points, False, None)))
    target = LocalMap(1).build(1, window, backend)
    assert len(target.points) == 8, "a point for each octant"
    assert not target.planar and backend.built == 1


def test_the_last_map_is_kept() -> None:
    """Several scans in a row to one model and an unchanged window: one map."""
    backend, local = Plain(), LocalMap(2)
    window = window_of(range(9))
    first = local.build(4, window, backend)
    assert local.build(4, window, backend) is first and backend.built == 1
    window.push(Node(9, 0.0, pose(9), prepared=first))  # beyond its neighbours
    assert local.build(4, window, backend) is first and backend.built == 1
    assert local.build(5, window, backend) is not first and backend.built == 2
    assert local.build(4, window, backend) is not first and backend.built == 3


def test_a_new_neighbour_makes_a_new_map() -> None:
    backend, local = Plain(), LocalMap(2)
    window = window_of(range(5))
    first = local.build(4, window, backend)
    window.push(Node(5, 0.0, pose(5), prepared=window.node(4).prepared))
    assert len(local.build(4, window, backend).points) == len(first.points) + 3


def test_the_same_scan_numbers_of_another_run_are_not_the_same_map() -> None:
    """One method may be used for two runs, one after the other."""
    backend, local = Plain(), LocalMap(2)
    one = local.build(4, window_of(range(9)), backend)
    other = local.build(4, window_of(range(9), drift=0.1), backend)
    assert not np.allclose(one.points, other.points)


def test_a_model_that_left_the_window() -> None:
    backend = Plain()
    window = window_of(range(9), capacity=4)
    for target in (SingleScan(), LocalMap(2)):
        with pytest.raises(KeyError, match="scan 4 is not in the window"):
            target.build(4, window, backend)


def test_a_scan_meets_its_local_map() -> None:
    """The edge is to the model scan, whatever else is in the target."""
    from rbtm_bench.check.none import AcceptAll
    from rbtm_bench.guess.identity import Identity
    from rbtm_bench.odometry.loop import odometry
    from rbtm_bench.odometry.method import Method
    from rbtm_bench.selection.oldest import Oldest
    from rbtm_bench.similarity.curvature import Curvature

    sizes: list[int] = []

    class Trusting(Plain):
        def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
            sizes.append(len(target.points))
            return Alignment(se2(0.1, 0, 0))

    method = Method(Trusting(), Curvature(), Oldest(4), Identity(), AcceptAll(), LocalMap(1))
    scans = [Scan(i, 0.0, WORLD[:10], planar=True) for i in range(6)]
    steps = list(odometry(scans, method))
    assert [step.record.model for step in steps] == [None, 0, 0, 0, 1, 2]
    assert [edge.model for step in steps for edge in step.edges] == [0, 0, 0, 1, 2]
    assert sizes == [10, 20, 20, 20, 20]


def test_a_map_is_thinned_by_its_own_voxels() -> None:
    """Two scans of one wall: 0.2 m apart as each scan is, one point a metre in the map."""
    backend = Plain(voxel_size=0.1)
    wall = np.column_stack([0.2 * np.arange(35) + 0.05, np.full(35, 0.5), np.zeros(35)])
    window = Window(5)
    for scan in range(2):
        window.push(
            Node(scan, 0.0, np.eye(4), prepared=Prepared(wall, True, None, ((scan, None),)))
        )
    as_scans, thinned = (LocalMap(1, v).build(0, window, backend) for v in (None, 1.0))
    assert len(as_scans.points) == 35
    expected = [[np.mean(0.2 * np.arange(5 * i, 5 * i + 5) + 0.05), 0.5, 0.0] for i in range(7)]
    np.testing.assert_allclose(np.sort(thinned.points, axis=0), expected)
    assert as_scans.key != thinned.key, "registrations to one are not those to the other"
