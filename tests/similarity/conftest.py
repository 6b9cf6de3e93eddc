"""Scans made by hand for the similarity tests."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import beam_points

Beams = Callable[[Array, Array], Scan]
Corners = Callable[[Sequence[tuple[float, float] | None]], Scan]
Room = Callable[[Array], Array]


@pytest.fixture
def beams() -> Beams:
    """A planar scan of ranges (B,) m at angles (B,) rad; NaN for no return."""

    def make(ranges: Array, angles: Array) -> Scan:
        points = beam_points(ranges, angles)
        return Scan(0, 0.0, points, planar=True, ranges=ranges, angles=angles)

    return make


@pytest.fixture
def corners(beams: Beams) -> Corners:
    """A planar scan that returns from these points (x, y) in this order; None: no return."""

    def make(points: Sequence[tuple[float, float] | None]) -> Scan:
        xy = np.array([(np.nan, np.nan) if p is None else p for p in points])
        angles = np.arctan2(xy[:, 1], xy[:, 0])
        known = np.isfinite(angles)
        order = np.arange(len(angles))
        angles = np.interp(order, order[known], angles[known])
        return beams(np.hypot(xy[:, 0], xy[:, 1]), angles)

    return make


@pytest.fixture
def room() -> Room:
    """The range (m) at any bearing (rad) in a room of nine walls, none parallel to another."""
    normals = np.radians([-170.0, -125.0, -92.0, -50.0, -21.0, 17.0, 62.0, 95.0, 148.0])
    distances = np.array([3.0, 3.4, 2.9, 3.3, 2.6, 2.4, 3.1, 2.5, 3.2])

    def ranges(bearing: Array) -> Array:
        facing = np.cos(bearing[:, None] - normals)
        to_wall = np.full(facing.shape, np.inf)
        np.divide(distances, facing, out=to_wall, where=facing > 0.01)
        return to_wall.min(axis=1)

    return ranges
