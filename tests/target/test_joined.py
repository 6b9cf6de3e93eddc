"""Targets of several scans: which they are, where they lie, and that adding one changes nothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from rbtm_bench.backends.base import Alignment, Backend, Placed, Prepared
from rbtm_bench.backends.plicp import PointToLineICP
from rbtm_bench.check.none import AcceptAll
from rbtm_bench.contract.scene import planar_scan
from rbtm_bench.core.geometry import inverse, se2, transform
from rbtm_bench.core.types import Array, Node
from rbtm_bench.guess.odometry import Odometry
from rbtm_bench.odometry import judge
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.odometry.method import Method
from rbtm_bench.selection.base import Selector
from rbtm_bench.selection.keyframe import Keyframe
from rbtm_bench.selection.previous import Previous
from rbtm_bench.selection.window import Keyframes, Window
from rbtm_bench.similarity.curvature import Curvature
from rbtm_bench.target.around_model import AroundModel
from rbtm_bench.target.base import Target
from rbtm_bench.target.keyframes import LastKeyframes
from rbtm_bench.target.nearby_keyframes import NearbyKeyframes

STEP = 0.1


def pose(scan: int) -> Array:
    return se2(STEP * scan, 0.01 * scan, 0.02 * scan)


class Counting(Backend):
    """Builds nothing; counts how often it would have."""

    def __init__(self) -> None:
        super().__init__()
        self.built = 0

    def build(self, points: Array, planar: bool) -> None:
        self.built += 1

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        return Alignment(T_target_source)


def fed(target: Target, backend: Backend, count: int, selected: Window) -> Window:
    """The target's window after ``count`` scans of a room at their true poses."""
    past = target.window(selected)
    for scan in range(count):
        node = Node(scan, 0.1 * scan, pose(scan), prepared=backend.prepare(planar_scan(pose(scan))))
        selected.push(node)
        if past is not selected:
            past.push(node)
    return past


def scans_of(prepared: Prepared) -> list[int]:
    return [number for number, _ in prepared.key]


def numbered(target: Target, model: int, count: int, selected: Window) -> list[int]:
    """Members of the target, told by how many points each scan has: three, its number at x."""
    past = target.window(selected)
    for scan in range(count):
        points = np.full((6, 3), float(scan))
        node = Node(scan, 0.0, pose(scan), prepared=Prepared(points, True, None, ((scan, None),)))
        selected.push(node)
        if past is not selected:
            past.push(node)
    return scans_of(target.build(model, past, Counting()))


def test_the_last_k_keyframes_whatever_the_model() -> None:
    """A keyframe every 5 scans: 0, 5, ... 40; of these the last three."""
    target = LastKeyframes(3, 5 * STEP, 90.0)
    assert numbered(target, 42, 43, Window(1)) == [30, 35, 40]
    assert numbered(target, 40, 43, Window(1, Keyframes(5 * STEP, 90.0))) == [30, 35, 40]
    assert numbered(LastKeyframes(20, 5 * STEP, 90.0), 42, 43, Window(1)) == list(range(0, 41, 5))


@pytest.mark.parametrize(
    ("older", "radius", "members"),
    [
        (0, 10.0, [30, 35, 40]),
        (2, 10.0, [10, 25, 30, 35, 40]),  # 30 stands .3 m from 10, .5 from 25, .58 from 5 and 15
        (9, 10.0, [0, 5, 10, 15, 20, 25, 30, 35, 40]),
        (9, 0.4, [10, 30, 35, 40]),
    ],
)
def test_older_keyframes_near_the_model(older, radius, members) -> None:
    """40 scans out on a line and back beside it, a keyframe every 5."""
    target = NearbyKeyframes(3, older, radius, 5 * STEP, 90.0)
    window = Window(60)
    past = target.window(window)
    for scan in range(43):
        x, y = (STEP * scan, 0.0) if scan <= 20 else (STEP * (40 - scan), 0.3)
        points = np.full((6, 3), float(scan))
        prepared = Prepared(points, True, None, ((scan, None),))
        node = Node(scan, 0.0, se2(x, y, 0.0), prepared=prepared)
        window.push(node)
        past.push(node)
    assert scans_of(target.build(30, past, Counting())) == members


def test_what_is_forgotten_is_not_near() -> None:
    target = NearbyKeyframes(3, 9, 10.0, 5 * STEP, 90.0, memory=5)
    assert numbered(target, 42, 43, Window(1)) == [20, 25, 30, 35, 40]


@pytest.mark.parametrize(
    ("model", "members"),
    [
        (20, [10, 15, 20, 25, 30]),  # a keyframe
        (22, [15, 20, 22, 25, 30]),  # between two
        (42, [35, 40, 42]),  # the scan before: nothing newer
        (13, [5, 10, 13, 15, 20]),  # the window's oldest has neighbours on either side
    ],
)
def test_neighbours_of_the_model_beyond_the_selector_s_window(model, members) -> None:
    assert numbered(AroundModel(2, 5 * STEP, 90.0), model, 43, Window(30)) == members


def test_neighbours_may_be_what_the_selector_keeps() -> None:
    assert numbered(AroundModel(2, 0, 0), 40, 43, Window(3)) == [38, 39, 40, 41, 42]
    kept = Window(3, Keyframes(10 * STEP, 90.0))
    assert numbered(AroundModel(2, 0, 0), 30, 43, kept) == [10, 20, 30, 40]


def test_neighbours_closer_than_the_selector_s_keyframes_reach_as_far_back() -> None:
    """Its three keyframes are 10 scans apart, neighbours 5: six of them, and two more."""
    kept = Window(3, Keyframes(10 * STEP, 90.0))
    assert numbered(AroundModel(2, 5 * STEP, 90.0), 20, 43, kept) == [10, 15, 20, 25, 30]


def test_memory_is_bounded() -> None:
    backend = Counting()
    past = fed(LastKeyframes(4, 2 * STEP, 90.0), backend, 60, Window(1))
    assert len(past) == 4
    past = fed(AroundModel(3, STEP / 2, 90.0), backend, 60, Window(7))
    assert len(past) == 10


def test_nothing_is_built_again_before_the_next_keyframe() -> None:
    backend, target = Counting(), LastKeyframes(3, 5 * STEP, 90.0)
    past = fed(target, backend, 32, Window(5))
    backend.built = 0
    first = target.build(31, past, backend)
    for model in (29, 30, 31, 30):
        again = target.build(model, past, backend)
        assert isinstance(again, Placed) == (model != 30)
    assert isinstance(first, Placed) and again.size == first.size
    assert backend.built == 1


BACKENDS: list[Callable[[], Backend]] = [Counting, PointToLineICP]


@pytest.mark.parametrize("make", BACKENDS)
def test_merging_by_hand_and_as_from_scratch(make: Callable[[], Backend]) -> None:
    """One target that lived through all scans, and one that comes new to the last."""
    backend, lived = make(), LastKeyframes(3, 5 * STEP, 90.0)
    selected = Window(5)
    past = lived.window(selected)
    for scan in range(33):
        prepared = backend.prepare(planar_scan(pose(scan), scan))
        node = Node(scan, 0.1 * scan, pose(scan), prepared=prepared)
        selected.push(node)
        past.push(node)
        kept = lived.build(scan, past, backend)
    fresh = LastKeyframes(3, 5 * STEP, 90.0).build(32, past, backend)
    assert scans_of(kept) == scans_of(fresh) == [20, 25, 30]
    assert kept.points.tobytes() == fresh.points.tobytes()
    parts = [planar_scan(pose(scan), scan).points for scan in (20, 25, 30)]
    placed = [
        transform(inverse(pose(32)) @ pose(scan), points)
        for scan, points in zip((20, 25, 30), parts, strict=True)
    ]
    np.testing.assert_allclose(kept.points, np.concatenate(placed), atol=1e-12)


def test_segments_are_those_of_each_scan() -> None:
    """Joined by plicp, a point keeps the neighbours that it has in its own scan; merged, it takes
    them from all."""
    backend = PointToLineICP()
    poses = [se2(0, 0, 0), se2(0.3, 0.1, 0.4), se2(0.7, -0.1, -2.0)]
    parts = [(backend.prepare(planar_scan(T, i)), T) for i, T in enumerate(poses)]
    joined = backend.join(parts)
    surface, start = joined.native, 0
    assert (np.diff(surface.points.xy[:, 0]) >= 0).all(), "sorted along its axis"
    place = np.argsort(surface.points.original)
    for part, _ in parts:
        own = part.native
        for p in range(len(own.sides)):
            sides = surface.sides[place[start + own.points.original[p]]]
            for side, alone in zip(sides, own.sides[p], strict=True):
                expected = -1 if alone < 0 else start + own.points.original[alone]
                assert (surface.points.original[side] if side >= 0 else -1) == expected
        start += len(own.sides)
    c, s = np.cos(surface.turn), np.sin(surface.turn)
    turned = joined.points[:, :2] @ np.array([[c, s], [-s, c]])
    np.testing.assert_allclose(surface.points.xy, turned[surface.points.original], atol=1e-12)
    assert backend.merge(parts).native.sides.tolist() != surface.sides.tolist()


def test_seen_from_another_scan_a_registration_is_the_same() -> None:
    """The edge is to the model scan, the information in the source's frame, whatever frame the
    cloud was built in; the judge finds the same."""
    backend = PointToLineICP()
    poses = [pose(scan) for scan in (0, 5, 10)]
    parts = [
        (backend.prepare(planar_scan(T, i)), inverse(poses[-1]) @ T) for i, T in enumerate(poses)
    ]
    built, source = backend.join(parts), backend.prepare(planar_scan(pose(12), 12))
    plain = judge.register(backend, source, built, inverse(poses[-1]) @ pose(11))
    T_built_target = inverse(poses[-1]) @ poses[0]
    placed = Placed(built, T_built_target)
    guess = inverse(poses[0]) @ pose(11)
    result = judge.register(backend, source, placed, guess)
    expected = inverse(T_built_target) @ plain.T_target_source
    np.testing.assert_allclose(result.T_target_source, expected, atol=1e-9)
    np.testing.assert_allclose(result.T_target_source, inverse(poses[0]) @ pose(12), atol=0.01)
    assert result.information is not None and plain.information is not None
    np.testing.assert_allclose(result.information, plain.information, rtol=1e-6)
    assert (result.fitness, result.inliers) == (plain.fitness, plain.inliers)


@pytest.mark.parametrize("selector", [Previous(), Keyframe(5 * STEP, 90.0)])
@pytest.mark.parametrize(
    ("target", "most"), [(LastKeyframes(3, 3 * STEP, 90.0), 3), (AroundModel(2, 0, 0), 5)]
)
def test_every_selector_fills_every_target(selector: Selector, target: Target, most: int) -> None:
    backend = PointToLineICP()
    method = Method(backend, Curvature(), selector, Odometry(), AcceptAll(), target)
    scans = [planar_scan(pose(i), i) for i in range(30)]
    scans = [
        type(s)(s.index, 0.1 * i, s.points, True, odometry=pose(i)) for i, s in enumerate(scans)
    ]
    steps = list(odometry(scans, method))
    members = [step.record.target_scans for step in steps]
    assert members[0] is None and members[1] == 1
    wanted = most if isinstance(target, LastKeyframes) else 3  # the newest has nothing newer
    assert members[-1] == wanted
    assert steps[-1].record.target_points == pytest.approx(wanted * len(scans[0].points), rel=0.05)
    assert steps[-1].edges[0].model == steps[-1].record.model
    np.testing.assert_allclose(steps[-1].T_world_scan, pose(29), atol=0.01)
