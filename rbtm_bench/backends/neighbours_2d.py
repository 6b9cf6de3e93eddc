"""Nearest neighbours among a few hundred planar points, compiled: a sweep along one axis.

A laser scan has so few points that a k-d tree costs more to build than it saves. Sorted along the
axis of larger spread, the search for the nearest point walks both ways until the axis alone is
farther than the best so far. Compiled once and cached; callers compile by their first call.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.types import Array


class Sorted2D(NamedTuple):
    """Planar points sorted along ``axis`` (0: x, 1: y): ``xy`` (N, 2) m, and where each of them
    came from (``original`` (N,))."""

    xy: Array
    original: NDArray[np.int64]
    axis: int


def sorted_2d(points: Array) -> Sorted2D:
    """Points (N, 2) or (N, 3) m, by their x and y, ready for ``nearest_2d``."""
    return Sorted2D(*_sorted(np.ascontiguousarray(points, dtype=np.float64)))


@kernel
def _sorted(points: Array) -> tuple[Array, NDArray[np.int64], int]:
    axis = 0
    if len(points) and np.ptp(points[:, 1]) > np.ptp(points[:, 0]):
        axis = 1
    order = np.argsort(points[:, axis], kind="mergesort")
    xy = np.empty((len(points), 2))
    for i in range(len(points)):
        xy[i, 0], xy[i, 1] = points[order[i], 0], points[order[i], 1]
    return xy, order, axis


@kernel
def nearest_2d(points: Sorted2D, x: float, y: float, radius: float) -> tuple[int, float]:
    """The place in ``points.xy`` of the point nearest to (x, y) m, and its distance in m; (-1,
    inf) if none is nearer than ``radius`` m. Of several equally near ones, always the same."""
    xy, axis = points.xy, points.axis
    along = x if axis == 0 else y
    low, high = 0, len(xy)
    while low < high:
        middle = (low + high) // 2
        if xy[middle, axis] < along:
            low = middle + 1
        else:
            high = middle
    best, nearest = radius * radius, -1
    up, down = low, low - 1
    while up < len(xy) or down >= 0:
        ahead = np.inf if up >= len(xy) else (xy[up, axis] - along) ** 2
        behind = np.inf if down < 0 else (along - xy[down, axis]) ** 2
        if min(ahead, behind) >= best:
            break
        place = up if ahead <= behind else down
        if ahead <= behind:
            up += 1
        else:
            down -= 1
        square = (xy[place, 0] - x) ** 2 + (xy[place, 1] - y) ** 2
        if square < best:
            best, nearest = square, place
    return nearest, (np.sqrt(best) if nearest >= 0 else np.inf)


@kernel
def tangent_at(points: Sorted2D, place: int, radius: float) -> tuple[int, float]:
    """How many points lie within ``radius`` of one of them, itself included, and the direction
    (rad) of their larger spread."""
    xy, axis = points.xy, points.axis
    x, y = xy[place, 0], xy[place, 1]
    n, mx, my, xx, xy_, yy = 0, 0.0, 0.0, 0.0, 0.0, 0.0
    for direction in (-1, 1):
        k = place if direction < 0 else place + 1
        while 0 <= k < len(xy) and abs(xy[k, axis] - xy[place, axis]) < radius:
            dx, dy = xy[k, 0] - x, xy[k, 1] - y
            if dx * dx + dy * dy < radius * radius:
                n += 1
                mx += dx
                my += dy
                xx += dx * dx
                xy_ += dx * dy
                yy += dy * dy
            k += direction
    a, b, d = xx - mx * mx / n, xy_ - mx * my / n, yy - my * my / n
    return n, 0.5 * np.arctan2(2.0 * b, a - d)
