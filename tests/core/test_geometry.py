"""Rigid motions: properties, and the places where formulas usually lose their digits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from rbtm_bench.core.geometry import (
    inverse,
    is_rigid,
    rotation_angle,
    se2,
    se3,
    symmetric,
    to_plane,
    to_rotation,
    transform,
    translation_norm,
    voxel_downsample,
    yaw,
)
from rbtm_bench.core.types import Array

coordinate = st.floats(-1e3, 1e3)
vector = hnp.arrays(float, 3, elements=coordinate)
axis = hnp.arrays(float, 3, elements=st.floats(-1, 1)).filter(lambda a: np.linalg.norm(a) > 1e-2)
clouds = hnp.arrays(float, st.tuples(st.integers(1, 60), st.just(3)), elements=st.floats(-50, 50))


@st.composite
def motions(draw: st.DrawFn) -> Array:
    rotation = Rotation.from_rotvec(draw(axis) * draw(st.floats(-3, 3)))
    return se3(draw(vector), rotation.as_matrix())


def about(direction: Array, angle: float) -> Array:
    """Rotation by angle about a direction, written out so that tiny angles survive."""
    n = direction / np.linalg.norm(direction)
    K = np.array([[0, -n[2], n[1]], [n[2], 0, -n[0]], [-n[1], n[0], 0]])
    return se3([0, 0, 0], np.eye(3) + np.sin(angle) * K + 2 * np.sin(angle / 2) ** 2 * K @ K)


def test_se2_by_hand():
    assert np.allclose(transform(se2(1, 2, np.pi / 2), np.array([[3.0, 0, 7]])), [[1, 5, 7]])


@given(T=motions())
def test_inverse_undoes_a_motion(T):
    assert np.allclose(inverse(T) @ T, np.eye(4), atol=1e-9)
    assert np.allclose(T @ inverse(T), np.eye(4), atol=1e-9)
    assert is_rigid(inverse(T))


def test_inverse_of_many_is_the_inverse_of_each():
    rng = np.random.default_rng(0)
    many = np.array(
        [se3(rng.normal(size=3), Rotation.random(rng=rng).as_matrix()) for _ in range(6)]
    )
    batch = inverse(many.reshape(2, 3, 4, 4)).reshape(6, 4, 4)
    assert np.allclose(batch, np.linalg.inv(many))
    assert np.allclose(inverse(many[0]), batch[0])


@given(a=motions(), b=motions(), points=clouds)
def test_transform_composes(a, b, points):
    assert np.allclose(transform(a @ b, points), transform(a, transform(b, points)), atol=1e-8)


@given(T=motions())
def test_translation_norm_and_angle_are_those_of_the_inverse(T):
    assert translation_norm(T) == pytest.approx(translation_norm(inverse(T)), rel=1e-12)
    assert rotation_angle(T) == pytest.approx(rotation_angle(inverse(T)), abs=1e-9)


@given(direction=axis, angle=st.floats(0, np.pi))
def test_rotation_angle(direction, angle):
    assert rotation_angle(about(direction, angle)) == pytest.approx(angle, abs=1e-14, rel=1e-12)


@given(direction=axis, exponent=st.floats(-15, -1))
def test_rotation_angle_keeps_its_digits_near_zero(direction, exponent):
    """arccos of the trace would be 0 below 1e-8."""
    angle = 10.0**exponent
    assert rotation_angle(about(direction, angle)) == pytest.approx(angle, rel=1e-12)


@given(direction=axis, exponent=st.floats(-12, -1))
def test_rotation_angle_keeps_its_digits_near_pi(direction, exponent):
    """arcsin of the skew part would fold back, and arccos loses half of the digits."""
    short = 10.0**exponent
    measured = np.pi - rotation_angle(about(direction, np.pi - short))
    assert measured == pytest.approx(short, abs=4e-15)
    assert rotation_angle(about(direction, np.pi + short)) == pytest.approx(
        np.pi - short, abs=4e-15
    )


def test_rotation_angle_of_many():
    angles = np.array([0.0, 0.1, 3.0])
    many = np.array([se2(1, 2, a) for a in angles])
    assert np.allclose(rotation_angle(many), angles)
    assert np.allclose(yaw(many), angles)
    assert np.allclose(translation_norm(many), np.sqrt(5))


@given(x=coordinate, y=coordinate, theta=st.floats(-3.14, 3.14))
def test_to_plane_keeps_planar_motions(x, y, theta):
    T = se2(x, y, theta)
    assert yaw(T) == pytest.approx(theta, abs=1e-12)
    assert np.allclose(to_plane(T), T, atol=1e-12)


@given(T=motions())
def test_to_plane_gives_a_planar_motion(T):
    flat = to_plane(T)
    assert is_rigid(flat)
    assert np.array_equal(flat[2], [0, 0, 1, 0])
    assert np.array_equal(flat[:2, 3], T[:2, 3])
    assert np.allclose(to_plane(flat), flat, atol=1e-12)


@given(T=motions(), noise=hnp.arrays(float, (3, 3), elements=st.floats(-0.05, 0.05)))
def test_to_rotation_is_a_rotation_and_the_nearest(T, noise):
    rough = T[:3, :3] + noise
    R = to_rotation(rough)
    assert is_rigid(se3([0, 0, 0], R), tolerance=1e-12)
    assert np.linalg.norm(rough - R) <= np.linalg.norm(noise) + 1e-12


def test_symmetric_is_so_to_the_last_bit_and_leaves_what_is_so():
    M = np.random.default_rng(0).normal(size=(5, 4, 4))
    S = symmetric(M)
    np.testing.assert_array_equal(S, np.swapaxes(S, 1, 2))
    np.testing.assert_array_equal(symmetric(S), S)
    np.testing.assert_array_equal(S[2], (M[2] + M[2].T) / 2)


def test_to_rotation_of_a_reflection_is_right_handed():
    assert is_rigid(se3([0, 0, 0], to_rotation(np.diag([1.0, 1.0, -1.0]))))


@given(T=motions())
def test_is_rigid_accepts_motions(T):
    assert is_rigid(T)


@pytest.mark.parametrize(
    "fault",
    [
        np.eye(3),
        np.eye(4)[None],
        np.zeros((4, 4)),
        np.full((4, 4), np.nan),
        np.diag([1.0, 1.0, -1.0, 1.0]),
        np.diag([1.00001, 1.0, 1.0, 1.0]),
        np.diag([1.0, 1.0, 1.0, 2.0]),
        se3([np.inf, 0, 0], np.eye(3)),
        se2(1, 2, 3).T,
    ],
)
def test_is_rigid_refuses(fault):
    assert not is_rigid(fault)


def test_is_rigid_tolerance():
    T = np.diag([1.001, 1.0, 1.0, 1.0])
    assert is_rigid(T, tolerance=0.01)
    assert not is_rigid(T, tolerance=0.001)


def test_voxel_downsample_by_hand():
    points = np.array([[0.9, 0, 0], [5, 5, 5], [0.1, 0, 0], [-0.1, 0, 0]])
    assert np.allclose(voxel_downsample(points, 1.0), [[0.5, 0, 0], [5, 5, 5], [-0.1, 0, 0]])


@given(points=clouds)
def test_voxel_downsample_with_zero_keeps_every_point(points):
    assert np.array_equal(voxel_downsample(points, 0.0), points)


def test_voxel_downsample_of_nothing():
    assert voxel_downsample(np.zeros((0, 3)), 0.5).shape == (0, 3)


@settings(max_examples=60)
@given(points=clouds, size=st.floats(0.01, 30), seed=st.integers(0, 99))
def test_voxel_downsample_gives_the_mean_of_every_voxel(points, size, seed):
    cells: dict[tuple[int, ...], list[Array]] = {}
    for point in points:
        cells.setdefault(tuple(np.floor(point / size).astype(int)), []).append(point)
    expected = np.array([np.mean(members, axis=0) for members in cells.values()])
    # A dict keeps the order of first appearance, as promised.
    assert np.allclose(voxel_downsample(points, size), expected, atol=1e-9)
    shuffled = voxel_downsample(np.random.default_rng(seed).permutation(points), size)
    assert len(shuffled) == len(expected)
    assert np.allclose(np.sort(shuffled, axis=0), np.sort(expected, axis=0), atol=1e-9)
