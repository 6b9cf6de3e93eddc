"""A running map: means by hand, what is forgotten, the libraries' own, and runs that end well."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.backends.base import Alignment, Backend, MapLimits, Placed, Prepared, RunningMap
from rbtm_bench.core.geometry import inverse, se2, se3, transform
from rbtm_bench.core.types import Array, Node, Scan
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.runs import assembly
from rbtm_bench.runs.settings import compose_settings
from rbtm_bench.selection.window import Window
from rbtm_bench.target.running_map import RunningVoxelMap
from rbtm_bench.target.voxels import VoxelMap


class Plain(Backend):
    """Builds nothing."""

    def build(self, points: Array, planar: bool) -> None:
        return None

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        return Alignment(T_target_source)


def prepared(points: Array, scan: int = 0, planar: bool = False) -> Prepared:
    return Prepared(np.asarray(points, float), planar, None, ((scan, None),))


def voxels(max_range: float = 100.0, horizon: int = 100) -> VoxelMap:
    return VoxelMap(Plain(0.6), MapLimits(max_range, horizon), 1.0)


EIGHT = np.array([[x, y, z] for x in (0.5, 1.5) for y in (0.5, 1.5) for z in (0.5, 1.5)])
"""In the middle of eight cells of 1 m."""


def sorted_points(running: RunningMap) -> Array:
    """The map's points in its own frame."""
    points = running.target().points
    return points[np.lexsort(points.T.round(9))]


def test_means_by_hand() -> None:
    """A second scan adds a point to each of four cells, at 0.2 m from the first along x."""
    running = voxels()
    running.insert(prepared(EIGHT), np.eye(4))
    np.testing.assert_allclose(sorted_points(running), sorted_points_of(EIGHT), atol=1e-12)
    running.insert(prepared(EIGHT - [1.8, 0, 0]), se3(np.array([1.0, 0, 0]), np.eye(3)))
    # 0.5 - 1.8 + 1 = -0.3: four new cells; 1.5 - 1.8 + 1 = 0.7: means (0.5 + 0.7) / 2 = 0.6
    expected = EIGHT.copy()
    expected[EIGHT[:, 0] == 0.5, 0] = 0.6
    new = EIGHT[EIGHT[:, 0] == 0.5] - [0.8, 0, 0]
    expected = sorted_points_of(np.concatenate([expected, new]))
    np.testing.assert_allclose(sorted_points(running), expected, atol=1e-12)


def sorted_points_of(points: Array) -> Array:
    return points[np.lexsort(points.T.round(9))]


def test_one_at_a_time_is_all_at_once() -> None:
    random = np.random.default_rng(0)
    scans = [random.normal(0.0, 5.0, (200, 3)) for _ in range(6)]
    poses = [se2(0.3 * i, 0.1 * i, 0.05 * i) for i in range(6)]
    running, whole = voxels(), voxels()
    for points, T in zip(scans, poses, strict=True):
        running.insert(prepared(points), T)
        running.target()
    world = [transform(T, points) for points, T in zip(scans, poses, strict=True)]
    whole.insert(prepared(np.concatenate(world)), np.eye(4))
    np.testing.assert_allclose(sorted_points(running), sorted_points(whole), atol=1e-9)


def test_what_no_scan_met_for_so_long_is_forgotten() -> None:
    """Three scans at x = 0, 10 and 10 m with a horizon of 2: the first is gone with the third."""
    running, far = voxels(horizon=2), se3(np.array([10.0, 0, 0]), np.eye(3))
    running.insert(prepared(EIGHT), np.eye(4))
    running.insert(prepared(EIGHT), far)
    assert running.target().size == 16
    running.insert(prepared(EIGHT), far)
    np.testing.assert_allclose(
        sorted_points(running), sorted_points_of(EIGHT + np.array([10, 0, 0])), atol=1e-9
    )


def test_what_is_met_again_is_not_forgotten() -> None:
    running, far = voxels(horizon=2), se3(np.array([10.0, 0, 0]), np.eye(3))
    for T in (np.eye(4), far, np.eye(4), far):
        running.insert(prepared(EIGHT), T)
    assert running.target().size == 16


def test_what_is_out_of_range_is_forgotten() -> None:
    running = voxels(max_range=5.0)
    for x in (0.0, 3.0, 6.0):
        running.insert(prepared(EIGHT), se3(np.array([x, 0, 0]), np.eye(3)))
    # from (6, 0, 0): all beyond 5 m is x = 0.5, and (1.5, 1.5, 1.5) at 4.97 m is not
    points = sorted_points(running)
    assert (np.linalg.norm(points - [6, 0, 0], axis=1) <= 5.0).all()
    assert len(points) == 4 + 8 + 8


def test_the_target_is_seen_from_the_model_and_says_which_scans_it_is_made_of() -> None:
    target, backend, window = RunningVoxelMap(1.0, horizon=3), Plain(), Window(10)
    poses = [se2(0.1 * i, 0.0, 0.3 * i) for i in range(5)]
    world = np.array([[x, y, 0.0] for x in (0.5, 1.5, 2.5) for y in (0.5, 1.5, 2.5)])
    for i, T in enumerate(poses):
        window.push(Node(i, 0.0, T, prepared=prepared(transform(inverse(T), world), i, True)))
    built = target.build(2, window, backend)
    assert isinstance(built, Placed) and [number for number, _ in built.key] == [2, 3, 4]
    points = sorted_points_of(transform(poses[2], built.points))
    np.testing.assert_allclose(points, sorted_points_of(world), atol=1e-9)
    T = se2(1, 2, 3)
    whole, motion = built.as_built(T)
    np.testing.assert_allclose(motion, inverse(poses[4]) @ poses[2] @ T, atol=1e-12)
    assert not isinstance(whole, Placed)


def test_only_scans_that_moved_are_added() -> None:
    target, backend = RunningVoxelMap(distance=0.5), Plain()
    selected = Window(1)
    past = target.window(selected)
    for i in range(21):
        node = Node(i, 0.0, se2(0.1 * i, 0, 0), prepared=prepared(EIGHT, i))
        selected.push(node)
        past.push(node)
        built = target.build(i, past, backend)
    assert [number for number, _ in built.key] == [0, 5, 10, 15, 20]


@pytest.mark.parametrize("name", ["small_gicp_vgicp", "kiss_icp"])
@pytest.mark.parametrize("world", ["2d", "3d"])
def test_libraries_maps_of_their_own(name: str, world: str) -> None:
    """A map of four scans registers the fifth, seen from any of them, in the plane and in space."""
    from rbtm_bench.contract.scene import WORLDS

    scene = WORLDS[world]
    words = [f"backend={name}", "registration.max_correspondence_distance=0.5"]
    words += ["backend.map_voxel_size=0.2"] if name == "kiss_icp" else []
    backend = assembly.build(compose_settings(words).config["backend"])
    window = Window(10)
    poses = [se2(0.05 * i, 0.02 * i, 0.02 * i) for i in range(5)]
    scans = [scene.scan(scene.start @ T, i, 0.0) for i, T in enumerate(poses)]
    for i in range(4):
        window.push(Node(i, 0.0, poses[i], prepared=backend.prepare(scans[i])))
    target = RunningVoxelMap()
    source = backend.prepare(scans[4])
    for model in (3, 0):
        built = target.build(model, window, backend)
        assert built.planar == (world == "2d") and built.size > 50
        guess = inverse(poses[model]) @ poses[3]
        T = backend.register(source, built, guess).T_target_source
        np.testing.assert_allclose(T, inverse(poses[model]) @ poses[4], atol=0.03)


@pytest.mark.slow
def test_kiss_icp_on_its_map_is_kiss_icp() -> None:
    """Its own pipeline beside ours on a simulated street: within a tenth of one another."""
    street = ["dataset=simulated", "dataset.scans=60", "registration.voxel_size=0"]
    ours = ["backend=kiss_icp", "backend.map_voxel_size=0.8", "target=map", "selector=previous"]
    ends = []
    for words in ([*street, *ours], [*street, "backend=kiss_icp_system"]):
        ends.append(final_error(words))
    assert ends[0] == pytest.approx(ends[1], rel=0.1)


@pytest.mark.slow
def test_a_running_map_of_gaussians_ends_nearer_than_the_scan_before() -> None:
    street = ["dataset=simulated", "dataset.scans=60", "backend=small_gicp_vgicp"]
    map_, before = (
        final_error([*street, "selector=previous", *words]) for words in (["target=map"], [])
    )
    assert map_ < 0.5 * before


def final_error(words: list[str]) -> float:
    """m between the last pose and the truth."""
    from rbtm_bench.backends.system import System
    from rbtm_bench.odometry.system import system_odometry

    parts = assembly.instantiate(compose_settings(words))
    scans: list[Scan] = list(parts.dataset)
    is_system = isinstance(parts.method, System)
    run = system_odometry if is_system else odometry
    last = [step.T_world_scan for step in run(iter(scans), parts.method)][-1]
    first, truth = scans[0].ground_truth, scans[-1].ground_truth
    return float(np.linalg.norm(last[:3, 3] - (inverse(first) @ truth)[:3, 3]))
