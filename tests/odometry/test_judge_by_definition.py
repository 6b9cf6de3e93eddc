"""The judge of planar pairs, and the sample that localizability is of, by their definitions."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.backends.base import Prepared
from rbtm_bench.backends.none import NoRegistration
from rbtm_bench.core.geometry import se2, transform
from rbtm_bench.core.types import Array
from rbtm_bench.odometry import judge
from rbtm_bench.odometry.judge import evaluate
from rbtm_bench.odometry.judge_plane import COUNT, LEVER, MATRIX, MAX_MATCHES, USED, plane_sums

RADIUS = 0.21


def wall(a: tuple[float, float], b: tuple[float, float], count: int) -> Array:
    """Points (count, 3) from a to b."""
    share = np.linspace(0.0, 1.0, count)[:, None]
    return np.column_stack([np.array(a) + share * (np.array(b) - np.array(a)), np.zeros(count)])


L_ROOM = np.concatenate([wall((-1, -1), (3, -1), 41), wall((3, -1), (3, 1), 21)])
"""A long wall along x and a short one along y, seen from (0, 0)."""


def cloud(points: Array, planar: bool = True) -> Prepared:
    return Prepared(np.array(points, dtype=float), planar, None)


def by_definition(source: Array, target: Array, T: Array) -> tuple[int, int, Array, float]:
    """Inliers, matches with a normal, the matrix of ``Localizability`` (3, 3) and its lever, of
    every k-th inlier so that at most ``MAX_MATCHES`` remain."""
    placed = transform(T, source)
    distance = np.linalg.norm(placed[:, None] - target[None], axis=2)
    nearest, match = distance.min(axis=1), distance.argmin(axis=1)
    inliers = [i for i in range(len(source)) if nearest[i] < RADIUS]
    k = next(k for k in range(1, len(inliers) + 1) if len(inliers[::k]) <= MAX_MATCHES)
    rows, points = [], []
    for i in inliers[::k]:
        around = np.linalg.norm(target - target[match[i]], axis=1) < RADIUS
        if around.sum() < 3:
            continue
        normal = np.linalg.eigh(np.cov(target[around, :2].T))[1][:, 0] @ T[:2, :2]
        x, y = source[i, :2]
        rows.append([*normal, x * normal[1] - y * normal[0]])
        points.append([x, y])
    j, p = np.array(rows), np.array(points)
    lever = float(np.sqrt((p**2).sum(axis=1).mean()))
    j[:, 2] /= lever
    return len(inliers), len(j), j.T @ j / len(j), lever


def assert_as_defined(source: Array, target: Array, T: Array) -> Array:
    """The compiled sums are those of the definition; the matrix."""
    count, used, matrix, lever = by_definition(source, target, T)
    sums = plane_sums(*cloud(target).index, source, T, RADIUS)
    assert (sums[COUNT], sums[USED]) == (count, used)
    assert sums[LEVER] == pytest.approx(lever, rel=1e-12)
    np.testing.assert_allclose(sums[MATRIX:].reshape(3, 3), matrix, rtol=0, atol=1e-9)
    return matrix


def test_localizability_of_an_l_shaped_room() -> None:
    """The walls do not balance about the sensor, so a shift along y goes with a turn."""
    matrix = assert_as_defined(L_ROOM, L_ROOM, np.eye(4))
    assert abs(matrix[1, 2]) > 0.1 and abs(matrix[0, 2]) < abs(matrix[1, 2])
    held = evaluate(cloud(L_ROOM), cloud(L_ROOM), np.eye(4), RADIUS).localizability
    assert held is not None
    np.testing.assert_allclose(held.axes[0], np.linalg.eigvalsh(matrix), atol=1e-9)


@pytest.mark.parametrize("T", [se2(0.03, -0.04, 0.02), se2(4.0, 2.0, 2.5)])
def test_localizability_of_a_room_seen_from_elsewhere(T: Array) -> None:
    random = np.random.default_rng(4)
    source = L_ROOM + random.normal(scale=0.01, size=L_ROOM.shape) * [1, 1, 0]
    assert_as_defined(source, transform(T, L_ROOM), T @ se2(0.01, 0.02, 0.005))


@pytest.mark.parametrize("count", [199, 200, 201, 399, 400, 401, 650])
def test_a_sample_of_planar_matches_is_spread_evenly(count: int) -> None:
    """A long wall first and a short one after it: a sample of the first ones would see one wall,
    one by another stride another share of the second."""
    corner = [wall((-2, -1), (3, -1), count - 60), wall((3, -1), (3, 1), 60)]
    assert_as_defined(np.concatenate(corner), np.concatenate(corner), np.eye(4))


@pytest.mark.parametrize(
    ("count", "kept"), [(0, 0), (1, 1), (200, 200), (201, 101), (400, 200), (401, 134), (999, 200)]
)
def test_a_sample_is_every_k_th_and_never_too_large(count: int, kept: int) -> None:
    """k is the least that leaves at most 200: 2 from 201 on, 3 from 401 on."""
    sample = np.arange(count)[judge._spread(count)]
    assert len(sample) == kept <= MAX_MATCHES
    assert len(set(np.diff(sample).tolist())) <= 1 and (count == 0 or sample[0] == 0)


def test_a_sample_in_space_is_spread_evenly() -> None:
    """401 points of a wall and a floor: every third counts, each wall by its share of these."""
    random = np.random.default_rng(1)
    floor = np.column_stack([random.uniform(-1, 1, (301, 2)), np.full(301, -1.0)])
    side = np.column_stack([np.full(100, 5.0), random.uniform(-1, 1, (100, 2))])
    both = cloud(np.concatenate([floor, side]), planar=False)
    held = evaluate(both, both, np.eye(4), 0.6).localizability
    assert held is not None
    of_floor = len(range(0, 301, 3))
    shares = [134 - of_floor, 0, of_floor]
    np.testing.assert_allclose(np.diag(held.matrix)[:3] * 134, shares, atol=1e-9)


def test_three_points_are_a_surface_and_two_are_none() -> None:
    """Along x: three 0.1 m apart, and far from them two. Only the middle one sees all three."""
    x = np.array([0.0, 0.15, 0.3, 8.0, 8.1, -9.0])
    points = np.column_stack([x, np.ones((6, 1)), np.zeros((6, 1))])
    sums = plane_sums(*cloud(points).index, points, np.eye(4), RADIUS)
    assert (sums[COUNT], sums[USED]) == (6, 1)
    assert sums[MATRIX + 4] == pytest.approx(1.0)
    assert sums[LEVER] == pytest.approx(np.hypot(0.15, 1.0))


# --- in space


def in_space(source: Array, target: Array, radius: float, neighbours: int) -> Array | None:
    """The matrix (6, 6) of source points on a target point each, with normals of so many nearest
    neighbours within the radius; None with fewer than three."""
    rows, places = [], []
    for point in source:
        distance = np.linalg.norm(target - target[((target - point) ** 2).sum(1).argmin()], axis=1)
        near = [i for i in np.argsort(distance)[:neighbours] if distance[i] < radius]
        if len(near) >= 3:
            normal = np.linalg.eigh(np.cov(target[near].T))[1][:, 0]
            rows.append([*normal, *np.cross(point, normal)])
            places.append(point)
    if len(rows) < 3:
        return None
    j = np.array(rows)
    j[:, 3:] /= np.sqrt((np.array(places) ** 2).sum(axis=1).mean())
    return j.T @ j / len(j)


def rough_wall(count: int) -> Array:
    """Points (count, 3) of a wall of 2 m by 2 m with a roughness of 0.1 m."""
    random = np.random.default_rng(count)
    return random.uniform(-1.0, 1.0, (count, 3)) * [1.0, 1.0, 0.1] + [0.5, 0.0, 2.0]


@pytest.mark.parametrize("count", [8, 60, 180])
@pytest.mark.parametrize("radius", [0.4, 5.0])
def test_localizability_in_space_by_definition(count: int, radius: float) -> None:
    """Of all points within the radius, but at most of the 20 nearest."""
    points = rough_wall(count)
    expected = in_space(points, points, radius, 20)
    both = cloud(points, planar=False)
    held = evaluate(both, both, np.eye(4), radius).localizability
    assert (held is None) == (expected is None)
    if held is not None and expected is not None:
        np.testing.assert_allclose(held.matrix, expected, atol=1e-9)


TRIPLE = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.0, 0.1, 1.0]])
"""Three points of a plane z = 1, all within 0.2 m."""


def test_three_matches_of_three_points_are_enough_in_space() -> None:
    """Each has the other two around it; of two matches nothing can be said, nor of two points."""
    far = TRIPLE + np.array([50.0, 0.0, 0.0])
    target = cloud(TRIPLE, planar=False)
    held = evaluate(target, target, np.eye(4), 0.2).localizability
    assert held is not None
    np.testing.assert_allclose(held.matrix[:3, :3], np.diag([0.0, 0.0, 1.0]), atol=1e-12)
    some = cloud(np.concatenate([TRIPLE[:2], far[2:]]), planar=False)
    assert evaluate(some, target, np.eye(4), 0.2).localizability is None
    assert evaluate(target, some, np.eye(4), 0.2).localizability is None


def test_three_matches_of_three_points_are_enough_in_the_plane() -> None:
    points = np.array([[0.0, 1.0, 0.0], [0.1, 1.0, 0.0], [0.2, 1.0, 0.0]])
    target = cloud(points)
    held = evaluate(target, target, np.eye(4), RADIUS).localizability
    assert held is not None and held.matrix[1, 1] == pytest.approx(1.0)
    away = cloud(points + np.array([[0, 0, 0], [0, 0, 0], [0, 50, 0]]))
    assert evaluate(away, target, np.eye(4), RADIUS).localizability is None


def test_planar_fitness_rmse_and_inliers_by_hand() -> None:
    """The radius itself is outside, and height counts for nothing."""
    line = cloud(np.column_stack([np.arange(10.0), np.zeros(10), np.zeros(10)]))
    source = np.array(
        [[0, 0, 0], [1, 0.1, 0], [2, 0, 0.2], [3, -0.2, 0], [4, RADIUS, 0], [50.0, 0, 0]]
    )
    evaluation = evaluate(cloud(source), line, np.eye(4), RADIUS)
    assert evaluation.fitness == pytest.approx(4 / 6)
    assert evaluation.inlier_rmse == pytest.approx(np.sqrt((0.01 + 0.04) / 4))
    assert evaluation.inliers == 4 and evaluation.localizability is None


@pytest.mark.parametrize(("radius", "inliers"), [(None, 8), (0.05, 4), (0.15, 6), (1.0, 10)])
def test_the_radius_of_the_judge_is_its_own(radius: float | None, inliers: int) -> None:
    """Ten points, 4 x 0, 2 x .1, 2 x .2 and 2 x .4 m beside ten others; 0.3 is the backend's."""
    backend = NoRegistration(max_correspondence_distance=0.3)
    target = np.column_stack([10.0 * np.arange(10), np.zeros(10), np.zeros(10)])
    source = target + np.array([0, 0, 0, 0, 0.1, 0.1, 0.2, 0.2, 0.4, 0.4])[:, None] * [0, 1, 0]
    pair = cloud(source), cloud(target)
    result = judge.register(backend, *pair, np.eye(4), radius=radius)
    assert (result.inliers, result.fitness) == (inliers, inliers / 10)
