"""How a map's points scatter around some of them, compiled: what map quality is made of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.types import Array

Integers = NDArray[np.int64]


def occupied_cells(points: Array, cell: float) -> int:
    """How many cells of ``cell`` m, one corner of which is the origin, hold a point (N, D)."""
    return len(np.unique(_keys(points, cell)[0]))


def scatter(points: Array, centres: Integers, radius: float) -> tuple[Integers, Array]:
    """The neighbours within ``radius`` m of the points (N, D) numbered ``centres`` (Q,), D <= 3.

    Returns how many each has, itself included (Q,), and their covariance (Q, D, D) m^2, divided
    by that number.
    """
    keys, rows = _keys(points, radius)
    order = np.argsort(keys, kind="stable")
    d = points.shape[1]
    space = np.zeros((len(points), 3))
    space[:, :d] = points
    number, first, second = _moments(
        space[order], keys[order], space[centres], keys[centres], rows, radius * radius
    )
    mean = first / number[:, None]
    covariance = second / number[:, None, None] - mean[:, :, None] * mean[:, None, :]
    return number, covariance[:, :d, :d]


def _keys(points: Array, cell: float) -> tuple[Integers, Integers]:
    """The number (N,) of every point's cell, consecutive along the last axis, and what to add to
    it for each of the 3^(D-1) rows of cells around (points: (N, D)).

    Gaps between occupied cells count as one cell, so a map that flew apart needs no more numbers
    than an integer can count.
    """
    keys, rows = np.zeros(len(points), dtype=np.int64), np.zeros(1, dtype=np.int64)
    for axis in range(points.shape[1]):
        occupied, place = np.unique(np.floor(points[:, axis] / cell), return_inverse=True)
        steps = np.where(np.diff(occupied) > 1.0, 2, 1)
        ranks = np.cumsum(np.concatenate([[1], steps]))  # 0 is the empty cell before the first,
        width = ranks[-1] + 2  # and another one follows the last
        keys, rows = keys * width + ranks[place], rows * width
        if axis < points.shape[1] - 1:
            rows = (rows[:, None] + np.array([-1, 0, 1])).ravel()
    return keys, rows


@kernel
def _moments(
    points: Array, keys: Integers, centres: Array, cells: Integers, rows: Integers, square: float
) -> tuple[Integers, Array, Array]:
    """Numbers (Q,), sums (Q, 3) and sums of squares (Q, 3, 3) of the points (N, 3), in the order
    of their ``keys``, nearer to each centre (Q, 3) than the root of ``square``, as seen from it."""
    number = np.zeros(len(centres), dtype=np.int64)
    first = np.zeros((len(centres), 3))
    second = np.zeros((len(centres), 3, 3))
    for q in range(len(centres)):
        x0, y0, z0 = centres[q]
        for row in rows:
            start = np.searchsorted(keys, cells[q] + row - 1)
            end = np.searchsorted(keys, cells[q] + row + 1, side="right")
            for i in range(start, end):
                x, y, z = points[i, 0] - x0, points[i, 1] - y0, points[i, 2] - z0
                if x * x + y * y + z * z > square:
                    continue
                number[q] += 1
                first[q, 0] += x
                first[q, 1] += y
                first[q, 2] += z
                second[q, 0, 0] += x * x
                second[q, 0, 1] += x * y
                second[q, 0, 2] += x * z
                second[q, 1, 1] += y * y
                second[q, 1, 2] += y * z
                second[q, 2, 2] += z * z
        second[q, 1, 0] = second[q, 0, 1]
        second[q, 2, 0] = second[q, 0, 2]
        second[q, 2, 1] = second[q, 1, 2]
    return number, first, second
