"""Normals and covariances in the plane, against what geometry says."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.backends.planar import covariances_of_discs, normals_2d
from rbtm_bench.core.types import Array


def flat(x: Array, y: Array) -> Array:
    """Points (N, 3) in z = 0."""
    return np.column_stack([x, y, np.zeros(len(x))])


def aligned(normals: Array, expected: Array) -> Array:
    """|cosine| between normals and unit vectors: the sign of a normal is free."""
    return np.abs((normals * expected).sum(axis=1))


@pytest.mark.parametrize("degrees", [0.0, 30.0, 90.0, 135.0, -60.0])
def test_a_wall_has_its_own_normal(degrees: float) -> None:
    angle = np.deg2rad(degrees)
    along = np.linspace(-1, 1, 41)
    normals = normals_2d(flat(2 + along * np.cos(angle), along * np.sin(angle)), 0.3, 30)
    expected = np.array([-np.sin(angle), np.cos(angle), 0.0])
    np.testing.assert_allclose(aligned(normals, expected[None]), 1.0, atol=1e-12)


def test_normals_are_unit_vectors_in_the_plane() -> None:
    xy = np.random.default_rng(0).uniform(-2, 2, (200, 2))
    normals = normals_2d(flat(xy[:, 0], xy[:, 1]), 0.3, 30)
    assert normals.shape == (200, 3)
    assert not normals[:, 2].any()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)


def test_a_circle_has_radial_normals() -> None:
    turn = np.linspace(0, 2 * np.pi, 180, endpoint=False)
    circle = flat(3 * np.cos(turn), 3 * np.sin(turn))
    normals = normals_2d(circle, 0.4, 30)
    np.testing.assert_allclose(aligned(normals, circle / 3), 1.0, atol=1e-12)  # by symmetry


def test_a_corner_bends_normals_only_nearby() -> None:
    leg = np.linspace(0.05, 2, 40)
    corner = np.concatenate([flat(leg, 0 * leg), [[0, 0, 0]], flat(0 * leg, leg)])
    normals = normals_2d(corner, 0.21, 30)
    on_x, on_y = corner[:, 0] > 0.22, corner[:, 1] > 0.22
    np.testing.assert_allclose(aligned(normals[on_x], np.array([[0, 1, 0]])), 1.0, atol=1e-12)
    np.testing.assert_allclose(aligned(normals[on_y], np.array([[1, 0, 0]])), 1.0, atol=1e-12)
    diagonal = np.array([[1, 1, 0]]) / np.sqrt(2)
    np.testing.assert_allclose(aligned(normals[[40]], diagonal), 1.0, atol=1e-12)


def test_lonely_points_use_their_five_nearest() -> None:
    along = np.linspace(0.0, 45.0, 10)  # m, far beyond the radius
    normals = normals_2d(flat(along, 0.5 * along), 0.1, 30)
    expected = np.array([[-0.5, 1.0, 0.0]]) / np.hypot(0.5, 1.0)
    np.testing.assert_allclose(aligned(normals, expected), 1.0, atol=1e-12)


def test_the_radius_keeps_other_walls_out() -> None:
    along = np.linspace(0, 2, 81)
    walls = np.concatenate([flat(along, 0 * along), flat(along, 0 * along + 0.5)])
    near = normals_2d(walls, 0.2, 100)
    np.testing.assert_allclose(aligned(near, np.array([[0, 1, 0]])), 1.0, atol=1e-12)
    ends = normals_2d(walls, 0.6, 100)[[0, 80]]
    assert aligned(ends, np.array([[0, 1, 0]])).max() < 0.99


def test_at_most_so_many_neighbours_count() -> None:
    bend = np.concatenate([np.linspace(0, 1, 21), np.ones(20)])
    rise = np.concatenate([np.zeros(21), np.linspace(0.05, 1, 20)])
    few, many = (normals_2d(flat(bend, rise), 1.0, count)[14] for count in (5, 30))
    assert abs(few[1]) == pytest.approx(1.0)
    assert abs(many[1]) < 0.99


def test_covariances_are_thin_across_the_wall_only() -> None:
    angle = np.deg2rad([0, 25, 90, 200])
    normals = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    for normal, covariance in zip(normals, covariances_of_discs(normals, 1e-3), strict=True):
        values, vectors = np.linalg.eigh(covariance)
        np.testing.assert_allclose(values, [1e-3, 1, 1], atol=1e-12)
        assert abs(vectors[:, 0] @ normal) == pytest.approx(1.0)
        np.testing.assert_allclose(covariance @ [0, 0, 1], [0, 0, 1], atol=1e-15)
