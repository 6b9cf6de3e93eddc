"""Open3D's information matrix from correspondences at hand: its own values, our convention."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial import cKDTree

from rbtm_bench.backends.open3d_gicp import Open3DGeneralizedICP
from rbtm_bench.backends.open3d_icp import Open3DICP, point_information
from rbtm_bench.backends.open3d_p2p import Open3DPointToPoint
from rbtm_bench.backends.open3d_p2plane import Open3DPointToPlane
from rbtm_bench.backends.open3d_symmetric import Open3DSymmetric
from rbtm_bench.contract.scene import WORLDS, rotation
from rbtm_bench.core.geometry import (
    adjoint,
    inverse,
    se2,
    se3,
    transform,
)
from rbtm_bench.core.types import Array
from rbtm_bench.odometry import judge

METHODS: list[type[Open3DICP]] = [
    Open3DPointToPoint,
    Open3DPointToPlane,
    Open3DSymmetric,
    Open3DGeneralizedICP,
]
PLANE = np.ix_([0, 1, 5], [0, 1, 5])
ROTATION_FIRST = np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])
MOTION = se3([0.9, -0.4, 0.2], rotation((0.2, -0.5, 1), 35))


def information_in_source_frame(information: Array, T_target_source: Array) -> Array:
    """Information (6, 6) of a small motion in the target's frame, exp(d) T, as that of one in the
    source's, T exp(d)."""
    A = adjoint(T_target_source)
    moved: Array = A.T @ information @ A
    return moved


def small_motion(d: Array) -> Array:
    """exp(d) of x, y, z, rx, ry, rz."""
    x, y, z, a, b, c = d
    return expm(np.array([[0, -c, b, x], [c, 0, -a, y], [-b, a, 0, z], [0, 0, 0, 0]]))


@pytest.mark.parametrize("T", [np.eye(4), se2(2, -1, 0.7), MOTION], ids=["eye", "plane", "space"])
def test_the_adjoint_carries_a_small_motion_through(T: Array) -> None:
    d = np.array([0.3, -0.2, 0.1, 0.05, -0.4, 0.2])
    np.testing.assert_allclose(
        T @ small_motion(d), small_motion(adjoint(T) @ d) @ T, rtol=0, atol=1e-12
    )


def test_the_same_motion_has_the_same_cost_in_either_frame() -> None:
    half = np.random.default_rng(0).standard_normal((6, 6))
    information = half.T @ half
    d = np.array([0.1, 0.2, -0.3, 0.02, 0.01, -0.03])
    moved = adjoint(MOTION) @ d
    cost = d @ information_in_source_frame(information, MOTION) @ d
    assert cost == pytest.approx(moved @ information @ moved, rel=1e-12)


def information_of(points: Array) -> Array:
    """Of matched points (N, 3) m as they lie in the source's frame."""
    matches = np.tile(np.arange(len(points), dtype=np.int32)[:, None], (1, 2))
    return point_information(transform(MOTION, points), matches, MOTION)


def test_one_point_by_hand() -> None:
    """(2, 3, 5) moves by (x + 5 ry - 3 rz, y - 5 rx + 2 rz, z + 3 rx - 2 ry)."""
    J = np.array([[1, 0, 0, 0, 5, -3], [0, 1, 0, -5, 0, 2], [0, 0, 1, 3, -2, 0]], dtype=float)
    information = information_of(np.array([[2.0, 3.0, 5.0]]))
    np.testing.assert_allclose(information, J.T @ J, rtol=0, atol=1e-12)


def test_the_cost_of_a_small_motion_is_how_far_it_moves_the_points() -> None:
    points = np.random.default_rng(1).uniform(-3, 3, (50, 3))
    d = 1e-6 * np.array([1.0, -2.0, 0.5, 0.7, -0.3, 0.9])
    moved = transform(small_motion(d), points) - points
    assert d @ information_of(points) @ d == pytest.approx((moved**2).sum(), rel=1e-5)


def library_information(method: Open3DICP, source: Any, target: Any, T: Array) -> Array:
    """Open3D's own, with its own neighbour search: rotation first, a motion in the target's
    frame."""
    import open3d as o3d

    information = o3d.pipelines.registration.get_information_matrix_from_point_clouds(
        source.native, target.native, method.distances[-1], T
    )
    return information_in_source_frame(np.asarray(information)[ROTATION_FIRST], T)


@pytest.mark.parametrize("settings", [{}, {"kernel": "tukey", "kernel_scale": 1.0}], ids=["", "k"])
@pytest.mark.parametrize("factors", [(1.0,), (2.0, 0.5)], ids=["one", "two"])
@pytest.mark.parametrize("cls", METHODS)
def test_it_is_the_library_s(
    cls: type[Open3DICP], factors: tuple[float, ...], settings: dict[str, Any]
) -> None:
    """Of the last distance, whatever the method and its kernel."""
    world = WORLDS["3d"]
    known = world.motions["from_far_guess"]
    method = cls(0.3, coarse_to_fine=factors, **settings)
    source, target = (method.prepare(scan) for scan in world.pair(known, 0.01))
    result = judge.register(method, source, target, known.guess)
    expected = library_information(method, source, target, result.T_target_source)
    assert result.information is not None and expected[0, 0] > 1000
    np.testing.assert_allclose(
        result.information, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max()
    )


@pytest.mark.parametrize("cls", METHODS)
def test_on_planar_scans_it_is_the_library_s_in_the_plane(cls: type[Open3DICP]) -> None:
    world, method = WORLDS["2d"], cls(0.3)
    known = world.motions["curve"]
    source, target = (method.prepare(scan) for scan in world.pair(known, 0.01))
    result = judge.register(method, source, target, known.guess)
    expected = library_information(method, source, target, result.T_target_source)
    assert result.information is not None and expected[0, 0] > 300
    np.testing.assert_allclose(
        result.information[PLANE], expected[PLANE], rtol=1e-6, atol=1e-6 * expected.max()
    )
    # nothing leaves the plane; x and y of points know nothing of each other but by rounding
    rest = result.information.copy()
    assert np.count_nonzero(rest[PLANE]) >= 7
    rest[PLANE] = 0.0
    assert not rest.any()
    assert abs(result.information[0, 1]) <= 1e-15 * 8 * expected[0, 0]


def test_it_is_the_bend_of_the_cost_at_fixed_correspondences() -> None:
    """Half the second derivative of the sum of squared distances, in the source's frame."""
    world = WORLDS["3d"]
    known = world.motions["from_far_guess"]
    method = Open3DPointToPoint(0.2)
    source, target = (method.prepare(scan) for scan in world.pair(known, 0.0))
    result = judge.register(method, source, target, known.guess)
    T = result.T_target_source
    distance, index = cKDTree(target.points).query(
        transform(T, source.points), distance_upper_bound=0.2
    )
    matched = target.points[index[np.isfinite(distance)]]

    def cost(d: Array) -> float:
        """Of a motion of the matched target points, seen from the source."""
        seen = transform(inverse(T), matched)
        return float(((transform(small_motion(d), seen) - seen) ** 2).sum())

    assert result.information is not None
    h = 1e-4 * np.eye(6)
    for i in range(6):
        assert cost(h[i]) == pytest.approx(1e-8 * result.information[i, i], rel=1e-3)
    assert cost(h[0] + h[4]) == pytest.approx(
        (h[0] + h[4]) @ result.information @ (h[0] + h[4]), rel=1e-3
    )


def test_nothing_matched_is_no_information() -> None:
    world, method = WORLDS["2d"], Open3DPointToPoint(0.3)
    source, target = (method.prepare(scan) for scan in world.pair(world.motions["still"]))
    result = judge.register(method, source, target, se2(100, 0, 0))
    assert result.information is not None and not result.information.any()
    assert result.converged is False
