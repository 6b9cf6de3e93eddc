"""small_gicp's four methods: known motions, planar scans in layers, what converged means."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from scipy.spatial import cKDTree

from rbtm_bench.backends.planar import lifted, normals_2d
from rbtm_bench.contract.scene import WORLDS, World
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.geometry import inverse, rotation_angle, se2, transform, translation_norm
from rbtm_bench.core.types import Array, RegistrationResult, Scan
from rbtm_bench.datasets.carmen import Carmen
from rbtm_bench.odometry import judge
from rbtm_bench.runs.settings import compose_settings

small_gicp = pytest.importorskip("small_gicp")
from rbtm_bench.backends.small_gicp import SmallGICP  # noqa: E402

Method = Literal["ICP", "PLANE_ICP", "GICP", "VGICP"]
METHODS: list[Method] = ["ICP", "PLANE_ICP", "GICP", "VGICP"]
PLANE = np.ix_([0, 1, 5], [0, 1, 5])


def register(method: SmallGICP, source: Scan, target: Scan, guess: Array) -> RegistrationResult:
    return judge.register(method, method.prepare(source), method.prepare(target), guess)


def off(T: Array, truth: Array) -> tuple[float, float]:
    """m and deg from the truth."""
    error = inverse(truth) @ T
    return float(translation_norm(error)), math.degrees(float(rotation_angle(error)))


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("motion", ["forward", "left", "turn", "curve", "from_far_guess"])
@pytest.mark.parametrize("world", list(WORLDS.values()), ids=str)
@pytest.mark.parametrize("name", METHODS)
def test_known_motions_forth_and_back(
    name: Method, world: World, motion: str, noise: float
) -> None:
    known, method = world.motions[motion], SmallGICP(name, 0.5)
    source, target = world.pair(known, noise)
    forth = register(method, source, target, known.guess)
    back = register(method, target, source, inverse(known.guess))
    for result, truth in ((forth, known.T_target_source), (back, inverse(known.T_target_source))):
        metres, degrees = off(result.T_target_source, truth)
        assert metres < (0.02 if name in ("ICP", "PLANE_ICP") else 0.005)
        assert degrees < (0.5 if name in ("ICP", "PLANE_ICP") else 0.15)
        assert result.converged is True and 1 <= (result.iterations or 0) <= 50


def test_at_z_0_the_library_s_own_normals_do_nothing() -> None:
    """Why planar scans are lifted: all normals are upright, so the guess comes back."""
    known = WORLDS["2d"].motions["curve"]
    clouds = [small_gicp.PointCloud(scan.points) for scan in WORLDS["2d"].pair(known)]
    for cloud in clouds:
        small_gicp.estimate_normals(cloud, small_gicp.KdTree(cloud), 10)
    tree = small_gicp.KdTree(clouds[1])
    result = small_gicp.align(
        clouds[1], clouds[0], tree, known.guess, registration_type="PLANE_ICP"
    )
    np.testing.assert_allclose(result.T_target_source, known.guess, atol=1e-12)


def test_layers_have_the_normals_of_the_plane() -> None:
    """Exactly upright walls, with the direction of a PCA in the plane (5 neighbours)."""
    scan = WORLDS["2d"].pair(WORLDS["2d"].motions["curve"], 0.01)[0]
    prepared = SmallGICP("PLANE_ICP", 0.5, neighbours=10).prepare(scan)
    normals = prepared.native.cloud.normals()[:, :3]
    assert len(normals) == 2 * len(scan.points)
    assert np.abs(normals[:, 2]).max() < 1e-9
    expected = np.tile(normals_2d(scan.points, 1e-9, 5), (2, 1))
    assert np.abs((normals * expected).sum(axis=1)).min() > 1 - 1e-9


def test_covariances_are_thin_across_the_wall_only() -> None:
    scan = WORLDS["2d"].pair(WORLDS["2d"].motions["curve"], 0.01)[0]
    cloud = SmallGICP("GICP", 0.5).prepare(scan).native.cloud
    for index, normal in enumerate(normals_2d(scan.points, 1e-9, 5)):
        covariance = cloud.cov(index)[:3, :3]
        np.testing.assert_allclose(covariance @ normal, 1e-3 * normal, atol=1e-6)
        np.testing.assert_allclose(covariance[2], [0, 0, 1], atol=1e-6)


def test_a_crowd_of_points_is_no_wall() -> None:
    """Neighbours that spread 1 m both ways get an upright normal, which says nothing in x and y."""
    random = np.random.default_rng(0)
    xy = random.uniform(-4, 4, (40, 2))
    points = np.column_stack([xy, np.zeros(40)])
    normals = SmallGICP("PLANE_ICP", 0.5, neighbours=20).prepare(Scan(0, 0.0, points, True))
    upright = np.abs(normals.native.cloud.normals()[:, 2])
    assert (upright > 0.999).all()


@pytest.mark.parametrize("cell_size", [0.1, 0.3, 0.7, 1.0, 2.5])
def test_layers_lie_in_the_middle_of_cells(cell_size: float) -> None:
    """One cell is centred on the origin, so a layer is a whole number of cells away from it."""
    layers = lifted(np.array([[1.0, 2.0, 0.0], [3.0, 4.0, 0.0]]), cell_size)
    cells = layers[:, 2] / cell_size
    np.testing.assert_allclose(cells, [-cells[2], -cells[2], cells[2], cells[2]])
    assert cells[2] >= 1 and abs(cells[2] - round(cells[2])) < 1e-9
    np.testing.assert_array_equal(layers[:, :2], [[1, 2], [3, 4], [1, 2], [3, 4]])


@pytest.mark.parametrize("name", METHODS)
def test_layers_keep_the_library_in_the_plane(name: Method) -> None:
    """Before anything is projected back."""
    known, method = WORLDS["2d"].motions["curve"], SmallGICP(name, 0.5)
    source, target = (method.prepare(scan) for scan in WORLDS["2d"].pair(known, 0.01))
    T = np.array(method.align(source, target, known.guess).T_target_source)
    np.testing.assert_allclose(T[2], [0, 0, 1, 0], atol=1e-9)
    np.testing.assert_allclose(T[:2, 2], 0, atol=1e-9)


def test_upright_walls_do_not_let_it_float_away(data_dir: Path) -> None:
    """Nothing holds them in z. Where correspondences go round, the library damps ever less, and
    rounding errors lift the scan out of the other's sight; put back every few steps, it stays."""
    log = Carmen(str(data_dir / "corrected" / "freiburg-101-corrected.log.gz"), max_scans=130)
    assert log.odometry is not None
    guess = inverse(log.odometry[128]) @ log.odometry[129]
    method = SmallGICP("PLANE_ICP", 0.5)
    source, target = method.prepare(log[129]), method.prepare(log[128])
    whole = method._call(source.native, target.native, guess, 50)
    assert abs(whole.T_target_source[2, 3]) > 0.5 and whole.num_inliers == 0
    result = judge.register(method, source, target, guess)
    assert result.fitness > 0.8 and result.converged is not False


def brute_force_information(source: Array, target: Array, T: Array, distance: float) -> Array:
    """Sum of J^T J over matched source points p, J = R [I, -skew(p)]: point-to-point."""
    distances, _ = cKDTree(target).query(transform(T, source), distance_upper_bound=distance)
    out = np.zeros((6, 6))
    for x, y, z in source[np.isfinite(distances)]:
        skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        J = T[:3, :3] @ np.hstack([np.eye(3), -skew])
        out += J.T @ J
    return out


@pytest.mark.parametrize("world", list(WORLDS.values()), ids=str)
def test_icp_information_is_that_of_the_matched_points(world: World) -> None:
    known, method = world.motions["from_far_guess"], SmallGICP("ICP", 0.5)
    source, target = (method.prepare(scan) for scan in world.pair(known, 0.01))
    result = judge.register(method, source, target, known.guess)
    expected = brute_force_information(source.points, target.points, result.T_target_source, 0.5)
    assert result.information is not None
    rows = PLANE if source.planar else np.ix_(range(6), range(6))
    np.testing.assert_allclose(
        result.information[rows], expected[rows], rtol=0.01, atol=0.002 * expected.max()
    )


@pytest.mark.parametrize("world", list(WORLDS.values()), ids=str)
def test_plane_information_is_that_of_its_residuals(world: World) -> None:
    """Which are the differences in x, y and z, times those of the normal: J = diag(n) R [I, -skew].
    Once for each point of the scan, though the library sees a planar one twice."""
    known, method = world.motions["from_far_guess"], SmallGICP("PLANE_ICP", 2.0)
    source, target = (method.prepare(scan) for scan in world.pair(known, 0.0))
    result = judge.register(method, source, target, known.guess)
    T, model = result.T_target_source, target.native.cloud
    points = source.native.cloud.points()[:, :3]
    nearest = cKDTree(model.points()[:, :3]).query(transform(T, points))[1]
    expected = np.zeros((6, 6))
    for (x, y, z), normal in zip(points, model.normals()[nearest, :3], strict=True):
        skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        J = np.diag(normal) @ T[:3, :3] @ np.hstack([np.eye(3), -skew])
        expected += J.T @ J / source.native.layers
    assert result.information is not None
    rows = PLANE if source.planar else np.ix_(range(6), range(6))
    np.testing.assert_allclose(
        result.information[rows], expected[rows], rtol=0.01, atol=0.002 * expected.max()
    )


def corridor(degrees: float) -> Scan:
    """Two bare walls, turned."""
    along = np.arange(-6, 6, 0.05)
    walls = np.concatenate([np.column_stack([along, 0 * along + y, 0 * along]) for y in (-1, 1)])
    points = transform(se2(0, 0, math.radians(degrees)), walls)
    points[:, :2] += 0.002 * np.random.default_rng(1).standard_normal((len(points), 2))
    return Scan(0, 0.0, points, True)


@pytest.mark.parametrize(
    ("name", "degrees"),
    [("GICP", 0), ("GICP", 25), ("VGICP", 0), ("VGICP", 25), ("PLANE_ICP", 0), ("PLANE_ICP", 90)],
)
def test_a_corridor_is_weak_along_its_axis(name: Method, degrees: float) -> None:
    scan = corridor(degrees)
    result = register(SmallGICP(name, 0.5), scan, scan, np.eye(4))
    assert result.information is not None
    values, vectors = np.linalg.eigh(result.information[:2, :2])
    axis = [math.cos(math.radians(degrees)), math.sin(math.radians(degrees))]
    assert values[0] < 0.02 * values[1]
    assert abs(vectors[:, 0] @ axis) > 0.99


def test_an_oblique_corridor_is_not_for_plane_icp() -> None:
    """At 45 deg the library's residuals are those of point-to-point, halved."""
    scan = corridor(45)
    result = register(SmallGICP("PLANE_ICP", 0.5), scan, scan, np.eye(4))
    assert result.information is not None
    half = 0.5 * len(scan.points) * np.eye(2)
    np.testing.assert_allclose(result.information[:2, :2], half, rtol=0.02, atol=5)


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("world", list(WORLDS.values()), ids=str)
def test_converged_is_what_happened(name: Method, world: World) -> None:
    known = world.motions["from_far_guess"]
    source, target = world.pair(known, 0.01)
    itself = register(SmallGICP(name, 0.5), target, target, np.eye(4))
    assert itself.converged is True
    cut_short = register(SmallGICP(name, 0.5, max_iterations=1), source, target, known.guess)
    assert cut_short.converged is False and cut_short.iterations == 1
    nothing = register(SmallGICP(name, 0.5), source, target, se2(500, 0, 0))
    assert nothing.converged is False and nothing.library_fitness == 0.0


def test_the_end_of_a_cycle_is_not_called_a_failure() -> None:
    """Two sets of correspondences for ever: the motion is right to millimetres, and None."""
    method = SmallGICP("ICP", 0.5, rotation_epsilon=1e-6, translation_epsilon=1e-6)

    class Ended:
        num_inliers, converged = 100, False
        H = 1e4 * np.eye(6)
        b = np.zeros(6)

    ended: Any = Ended()
    ended.b[3] = 1e4 * 5e-5  # a last step of 0.05 mm
    assert method._converged(ended, is_out_of_iterations=True) is None
    assert method._converged(ended, is_out_of_iterations=False) is None
    ended.b[3] = 1e4 * 0.01
    assert method._converged(ended, is_out_of_iterations=True) is False
    ended.b[3] = 1e4 * 5e-7
    assert method._converged(ended, is_out_of_iterations=False) is True


@pytest.mark.parametrize("name", METHODS)
def test_the_distance_holds_for_every_method(name: Method) -> None:
    """Half of the source lies 0.4 m off: within 0.6 m it counts, within 0.2 m it does not."""
    world = WORLDS["3d"]
    target = world.scan(world.start, 2, 0.005)
    half = target.points[:, 0] > np.median(target.points[:, 0])
    points = target.points[half] + np.array([0.0, 0.0, 0.4])
    source = Scan(1, 0.1, np.concatenate([target.points[~half], points]))
    cell = {"cell_size": 1.0} if name == "VGICP" else {}
    share = {}
    for distance in (0.2, 0.6):
        method = SmallGICP(name, distance, max_iterations=1, **cell)
        share[distance] = register(method, source, target, np.eye(4)).library_fitness or 0.0
    assert share[0.2] < share[0.6] - 0.2


def test_a_floor_on_a_round_height_is_not_torn() -> None:
    """1 m below the sensor, where the library's own voxels of 1 m meet and are 0.5 m off."""
    world = WORLDS["3d"]
    source, target = world.pair(world.motions["still"])
    result = register(SmallGICP("VGICP", 1.0), source, target, np.eye(4))
    assert off(result.T_target_source, np.eye(4))[0] < 0.005


@pytest.mark.parametrize(
    "words",
    [
        ["backend=small_gicp_icp", "backend.method=DICP"],
        ["backend=small_gicp_icp", "backend.cell_size=1.0"],
        ["backend=small_gicp_gicp", "backend.neighbours=5"],
        ["backend=small_gicp_vgicp", "backend.cell_size=0"],
    ],
)
def test_settings_that_the_library_would_swallow_are_refused(words: list[str]) -> None:
    with pytest.raises(ConfigError, match=words[1].split("=")[0]):
        compose_settings(words)


def test_cells_belong_to_vgicp() -> None:
    with pytest.raises(ConfigError, match="GICP has no cells"):
        SmallGICP("GICP", 0.5, cell_size=1.0)
