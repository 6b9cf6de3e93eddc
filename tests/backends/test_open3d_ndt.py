"""Open3D's NDT: known motions in plane and space, and what it keeps to itself."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rbtm_bench.backends.open3d_ndt import Open3DNDT
from rbtm_bench.backends.open3d_p2p import Open3DPointToPoint
from rbtm_bench.contract.scene import WORLDS, World, cloud
from rbtm_bench.core.errors import BackendError, ConfigError
from rbtm_bench.core.geometry import inverse, rotation_angle, se2, translation_norm
from rbtm_bench.core.types import Array, RegistrationResult, Scan
from rbtm_bench.odometry import judge
from rbtm_bench.runs.settings import compose_settings


def register(method: Open3DNDT, source: Scan, target: Scan, guess: Array) -> RegistrationResult:
    return judge.register(method, method.prepare(source), method.prepare(target), guess)


def off(T: Array, truth: Array) -> tuple[float, float]:
    """m and deg from the truth."""
    error = inverse(truth) @ T
    return float(translation_norm(error)), math.degrees(float(rotation_angle(error)))


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("motion", ["forward", "left", "turn", "curve", "from_far_guess"])
@pytest.mark.parametrize("world", list(WORLDS.values()), ids=str)
def test_known_motions(world: World, motion: str, noise: float) -> None:
    known = world.motions[motion]
    source, target = world.pair(known, noise)
    result = register(Open3DNDT(), source, target, known.guess)
    metres, degrees = off(result.T_target_source, known.T_target_source)
    assert metres < 0.005 and degrees < 0.1
    assert result.converged is None and result.iterations is None


def test_a_planar_scan_is_as_good_as_a_slab_of_it() -> None:
    """Cells have a thickness of their own: z = 0 needs no layers, and nothing leaves the plane."""
    world, method = WORLDS["2d"], Open3DNDT()
    known = world.motions["curve"]
    scans = world.pair(known, 0.01)
    source, target = (method.prepare(scan) for scan in scans)
    raw = method.align(source, target, known.guess).T_target_source
    np.testing.assert_allclose(raw[2], [0, 0, 1, 0], atol=1e-9)
    layers = [
        np.concatenate([s.points + np.array([0, 0, z]) for z in (-0.1, 0, 0.1)]) for s in scans
    ]
    slabs = [Scan(s.index, s.stamp, p) for s, p in zip(scans, layers, strict=True)]
    slab = register(method, *slabs, known.guess).T_target_source
    flat_off, slab_off = off(raw, known.T_target_source)[0], off(slab, known.T_target_source)[0]
    assert flat_off < 0.002 and slab_off < 0.002


@pytest.mark.parametrize("seed", range(3))
def test_a_few_points_find_their_place_among_cells(seed: int) -> None:
    """One source point in ten, 20 mm of noise: the nearest point lies anywhere around its true
    place, a cell's mean and covariance are those of the surface."""
    world = WORLDS["3d"]
    truth = world.motions["curve"].T_target_source
    source = cloud(world.start @ truth, 2 * seed, 0.02, 300)
    target = cloud(world.start, 2 * seed + 1, 0.02, 3000)
    cells, points = (
        off(
            judge.register(m, m.prepare(source), m.prepare(target), np.eye(4)).T_target_source,
            truth,
        )[0]
        for m in (Open3DNDT(), Open3DPointToPoint(1.0))
    )
    assert cells < 0.01 and cells < 0.5 * points


def test_nothing_near_a_cell_is_said_and_not_printed(capfd: pytest.CaptureFixture[str]) -> None:
    world = WORLDS["2d"]
    source, target = world.pair(world.motions["still"])
    guess = se2(100.0, 0.0, 0.3)
    result = register(Open3DNDT(), source, target, guess)
    assert result.converged is False and result.library_fitness == 0.0
    assert capfd.readouterr() == ("", "")


def test_a_target_without_cells_is_an_error() -> None:
    points = np.column_stack([5.0 * np.arange(20.0), np.zeros(20), np.zeros(20)])
    with pytest.raises(BackendError, match="voxel"):
        register(Open3DNDT(), Scan(0, 0.0, points), Scan(1, 0.1, points), np.eye(4))


def test_the_correspondence_distance_is_the_evaluator_s_only() -> None:
    world = WORLDS["3d"]
    known = world.motions["curve"]
    source, target = world.pair(known, 0.01)
    near, far = (register(Open3DNDT(d), source, target, known.guess) for d in (0.05, 1.0))
    assert near.T_target_source.tobytes() == far.T_target_source.tobytes()
    assert near.fitness < far.fitness


def test_neighbouring_cells_take_in_more_points() -> None:
    """Points beyond the border of a cell have a partner; both ways give the motion."""
    world = WORLDS["2d"]
    known = world.motions["curve"]
    source, target = world.pair(known, 0.01)
    own, neighbours = (
        register(Open3DNDT(face_neighbours=faces), source, target, known.guess)
        for faces in (False, True)
    )
    for result in (own, neighbours):
        assert off(result.T_target_source, known.T_target_source)[0] < 0.005
    assert own.library_fitness is not None and neighbours.library_fitness is not None
    assert own.library_fitness < neighbours.library_fitness


@pytest.mark.parametrize("wrong", ["min_points=3", "eigenvalue_ratio=1.0", "cell_size=0"])
def test_settings_out_of_bounds_are_refused_before_the_library_sees_them(wrong: str) -> None:
    with pytest.raises(ConfigError, match=wrong.split("=")[0]):
        compose_settings(["backend=open3d_ndt", f"backend.{wrong}"])
