"""The normal distributions of a planar scan (Biber and Strasser 2003, section III), compiled.

Four grids of square cells, shifted by half a cell in x, in y and in both, so that a point lies in
four cells. A cell is named by the half-cell at its lower left corner: all four grids in one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.types import Array

EMPTY = -1
"""No cell."""


class Cells(NamedTuple):
    """Cells with a normal distribution, looked up by half-cell.

    ``normals`` (C, 5): mean x, y (m) and inverse covariance xx, xy, yy (1/m^2). ``slots`` is a
    hash table from half-cells to rows of ``over`` (H, 4), where the rows of ``normals`` of the
    cells over it are, -1 for none. ``size`` m is a cell's side.
    """

    normals: Array
    slots: NDArray[np.int64]
    over: NDArray[np.int64]
    size: float


@kernel
def half_cell(x: float, size: float) -> int:
    """Number of the half-cell that holds a coordinate (m)."""
    return math.floor(2.0 * x / size)


@kernel
def place(slots: NDArray[np.int64], i: int, j: int) -> int:
    """Where (i, j) is in a hash table, or the free place where it belongs."""
    mask = len(slots) - 1
    at = (i * 73856093 ^ j * 19349663) & mask
    while slots[at, 2] >= 0 and (slots[at, 0] != i or slots[at, 1] != j):
        at = (at + 1) & mask
    return at


@kernel
def table(entries: int) -> NDArray[np.int64]:
    """An empty hash table (M, 3), at most half full: i, j and a value, -1 where it is free."""
    length = 8
    while length < 2 * entries:
        length *= 2
    return np.full((length, 3), EMPTY, np.int64)


@kernel
def cells_of(points: Array, size: float, min_points: int, ratio: float) -> Cells:
    """The cells of planar points (N, 2 or 3) m that hold at least ``min_points`` of them.

    The smaller eigenvalue of a covariance is at least ``ratio`` of the larger one.
    """
    corners, moments = _moments(points, size)
    normals = np.empty((len(moments), 5))
    kept = np.empty((len(moments), 2), np.int64)
    count = 0
    for cell in range(len(moments)):
        if moments[cell, 0] >= min_points and _normal(moments[cell], ratio, normals[count]):
            normals[count, 0] += 0.5 * size * (corners[cell, 0] + 1)
            normals[count, 1] += 0.5 * size * (corners[cell, 1] + 1)
            kept[count] = corners[cell]
            count += 1
    slots = table(4 * count)
    over = np.full((4 * count, 4), EMPTY, np.int64)
    halves = 0
    for cell in range(count):
        for quarter in range(4):
            i, j = kept[cell, 0] + quarter % 2, kept[cell, 1] + quarter // 2
            at = place(slots, i, j)
            if slots[at, 2] < 0:
                slots[at, 0], slots[at, 1], slots[at, 2] = i, j, halves
                halves += 1
            over[slots[at, 2], quarter] = cell
    return Cells(normals[:count].copy(), slots, over[:halves].copy(), size)


@kernel
def _moments(points: Array, size: float) -> tuple[NDArray[np.int64], Array]:
    """Lower left half-cells (C, 2) of all cells with points, and the moments (C, 6) of these
    about the cell's centre: count, x, y, xx, xy, yy."""
    slots = table(4 * len(points))
    corners = np.empty((4 * len(points), 2), np.int64)
    moments = np.zeros((4 * len(points), 6))
    count = 0
    for point in range(len(points)):
        for quarter in range(4):
            i = half_cell(points[point, 0], size) - quarter % 2
            j = half_cell(points[point, 1], size) - quarter // 2
            at = place(slots, i, j)
            if slots[at, 2] < 0:
                slots[at, 0], slots[at, 1], slots[at, 2] = i, j, count
                corners[count, 0], corners[count, 1] = i, j
                count += 1
            x = points[point, 0] - 0.5 * size * (i + 1)
            y = points[point, 1] - 0.5 * size * (j + 1)
            moment = moments[slots[at, 2]]
            moment[0] += 1.0
            moment[1] += x
            moment[2] += y
            moment[3] += x * x
            moment[4] += x * y
            moment[5] += y * y
    return corners[:count], moments[:count]


@kernel
def _normal(moment: Array, ratio: float, out: Array) -> bool:
    """Mean and inverse covariance (5,) of moments (6,) into ``out``; False for a single place."""
    n = moment[0]
    mean_x, mean_y = moment[1] / n, moment[2] / n
    xx = moment[3] / n - mean_x * mean_x
    xy = moment[4] / n - mean_x * mean_y
    yy = moment[5] / n - mean_y * mean_y
    middle, radius = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    largest = middle + radius
    if not largest > 0.0:
        return False
    smallest = max(middle - radius, ratio * largest)
    along = 0.5 * math.atan2(2.0 * xy, xx - yy)
    c, s = math.cos(along), math.sin(along)
    out[0], out[1] = mean_x, mean_y
    out[2] = c * c / largest + s * s / smallest
    out[3] = c * s * (1.0 / largest - 1.0 / smallest)
    out[4] = s * s / largest + c * c / smallest
    return True
