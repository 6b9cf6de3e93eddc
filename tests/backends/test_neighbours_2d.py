"""Nearest planar points and the tangents of surfaces, against looking at every point."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.backends.neighbours_2d import nearest_2d, sorted_2d, tangent_at
from rbtm_bench.core.types import Array

RANDOM = np.random.default_rng(8)
CLOUDS = {
    "wide": RANDOM.uniform(-1.0, 1.0, (60, 2)) * [4.0, 1.0],
    "high": RANDOM.uniform(-1.0, 1.0, (60, 2)) * [1.0, 4.0],
    "a wall along y": np.column_stack([np.full(40, 2.0), np.linspace(-2.0, 2.0, 40)]),
    "one": np.array([[0.5, 0.5]]),
}


@pytest.mark.parametrize("name", CLOUDS)
@pytest.mark.parametrize("radius", [0.3, 2.0, 50.0])
def test_the_nearest_point_is_the_nearest_of_all(name: str, radius: float) -> None:
    cloud = CLOUDS[name]
    points = sorted_2d(cloud)
    for x, y in np.random.default_rng(2).uniform(-5.0, 5.0, (80, 2)):
        distances = np.hypot(cloud[:, 0] - x, cloud[:, 1] - y)
        place, distance = nearest_2d(points, x, y, radius)
        if distances.min() < radius:
            assert distance == pytest.approx(distances.min(), rel=1e-12)
            assert points.original[place] == distances.argmin()
        else:
            assert (place, distance) == (-1, np.inf)


def test_a_point_at_the_radius_itself_is_too_far() -> None:
    points = sorted_2d(np.array([[0.0, 0.0], [8.0, 0.0]]))
    assert nearest_2d(points, 0.5, 0.0, 0.5) == (-1, np.inf)
    assert nearest_2d(points, 0.5, 0.0, 0.5000001) == (0, 0.5)
    assert nearest_2d(points, 0.0, -0.5, 0.5) == (-1, np.inf)


def principal(around: Array) -> Array:
    """The direction (2,) of the largest spread."""
    return np.linalg.eigh(np.cov(around.T))[1][:, 1]


@pytest.mark.parametrize("name", ["wide", "high", "a wall along y"])
def test_a_tangent_is_the_direction_of_the_larger_spread(name: str) -> None:
    cloud, radius = CLOUDS[name], 0.9
    points = sorted_2d(cloud)
    for place in range(len(cloud)):
        around = cloud[np.linalg.norm(cloud - points.xy[place], axis=1) < radius]
        count, angle = tangent_at(points, place, radius)
        assert count == len(around)
        if count >= 3:
            direction = np.array([np.cos(angle), np.sin(angle)])
            assert abs(direction @ principal(around)) == pytest.approx(1.0, abs=1e-9)
