"""The nearest of points in space, exactly, compiled: a hash of cubic cells.

Cells are as wide as the search reaches, so that a point's neighbours lie in the 27 cells around it.
Of many points one index is made a radius, and shared by all that ask for it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.types import Array

X, Y, Z = 73856093, 19349663, 83492791
"""Primes that spread cells over the table (Teschner et al. 2003)."""


class SpaceIndex(NamedTuple):
    """Points (N, 3) m, cell by cell; ``cells`` (C, 3) the cells' integer coordinates, ``start``
    (C + 1,) where each begins, ``table`` (a power of 2,) the cell at each place of the hash, -1 for
    none; cells are ``width`` m wide."""

    points: Array
    cells: NDArray[np.int64]
    start: NDArray[np.int64]
    table: NDArray[np.int64]
    width: float


def space_index(points: Array, radius: float) -> SpaceIndex:
    """Points (N, 3) m for searches within ``radius`` m; N >= 1."""
    width = max(radius, 1e-9 * float(np.abs(points).max()))  # integers must hold the cells
    return SpaceIndex(*_hashed(points, width), width)


@kernel
def _place(table: NDArray[np.int64], cells: NDArray[np.int64], x: int, y: int, z: int) -> int:
    """Where a cell is in the table, or the free place where it would be."""
    mask = len(table) - 1
    place = (x * X ^ y * Y ^ z * Z) & mask
    while True:
        cell = table[place]
        if cell < 0:
            return place
        if cells[cell, 0] == x and cells[cell, 1] == y and cells[cell, 2] == z:
            return place
        place = (place + 1) & mask


@kernel
def _hashed(
    points: Array, width: float
) -> tuple[Array, NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    count = len(points)
    size = 16
    while size < 2 * count:
        size *= 2
    table = np.full(size, -1, np.int64)
    cells = np.empty((count, 3), np.int64)
    cell_of = np.empty(count, np.int64)
    used = 0
    for i in range(count):
        x = int(np.floor(points[i, 0] / width))
        y = int(np.floor(points[i, 1] / width))
        z = int(np.floor(points[i, 2] / width))
        place = _place(table, cells, x, y, z)
        if table[place] < 0:
            table[place] = used
            cells[used, 0], cells[used, 1], cells[used, 2] = x, y, z
            used += 1
        cell_of[i] = table[place]
    start = np.zeros(used + 1, np.int64)
    for i in range(count):
        start[cell_of[i] + 1] += 1
    for c in range(used):
        start[c + 1] += start[c]
    fill = start[:used].copy()
    ordered = np.empty((count, 3))
    for i in range(count):
        k = fill[cell_of[i]]
        fill[cell_of[i]] += 1
        ordered[k, 0], ordered[k, 1], ordered[k, 2] = points[i, 0], points[i, 1], points[i, 2]
    return ordered, cells[:used].copy(), start, table


@kernel
def nearest_in_space(
    index: SpaceIndex,
    x: float,
    y: float,
    z: float,
    best: float,
) -> tuple[int, float]:
    """The place in ``points`` of the one nearest to (x, y, z) m and its squared distance (m^2), if
    that is less than ``best``, at most the width squared; else -1 and ``best``."""
    points, cells, start, table, width = index
    nearest = -1
    cx, cy, cz = int(np.floor(x / width)), int(np.floor(y / width)), int(np.floor(z / width))
    fx, fy, fz = x - cx * width, y - cy * width, z - cz * width
    for step in range(27):  # the cell itself first: what it gives rules most others out
        k = (step + 13) % 27
        dx, dy, dz = k // 9 - 1, (k // 3) % 3 - 1, k % 3 - 1
        ox = 0.0 if dx == 0 else (fx if dx < 0 else width - fx)
        oy = 0.0 if dy == 0 else (fy if dy < 0 else width - fy)
        oz = 0.0 if dz == 0 else (fz if dz < 0 else width - fz)
        # a shade less, because the cell of a point on its border is a matter of rounding
        if (ox * ox + oy * oy + oz * oz) * (1.0 - 1e-9) > best:
            continue
        cell = table[_place(table, cells, cx + dx, cy + dy, cz + dz)]
        if cell < 0:
            continue
        for i in range(start[cell], start[cell + 1]):
            a, b, c = points[i, 0] - x, points[i, 1] - y, points[i, 2] - z
            square = a * a + b * b + c * c
            if square < best:
                best, nearest = square, i
    return nearest, best


@kernel
def neighbours_in_space(
    index: SpaceIndex,
    place: int,
    places: NDArray[np.int64],
    squares: Array,
) -> int:
    """Fill ``places`` and ``squares`` (both (K,)) with the nearest points of one of them that lie
    within the width, itself first; returns how many those are, at most K."""
    points, cells, start, table, width = index
    x, y, z = points[place, 0], points[place, 1], points[place, 2]
    cx, cy, cz = int(np.floor(x / width)), int(np.floor(y / width)), int(np.floor(z / width))
    count, reach = 0, width * width
    for k in range(27):
        cell = table[_place(table, cells, cx + k // 9 - 1, cy + (k // 3) % 3 - 1, cz + k % 3 - 1)]
        if cell < 0:
            continue
        for i in range(start[cell], start[cell + 1]):
            a, b, c = points[i, 0] - x, points[i, 1] - y, points[i, 2] - z
            square = a * a + b * b + c * c
            if square >= reach or (count == len(places) and square >= squares[count - 1]):
                continue
            at = count if count < len(places) else count - 1
            count = min(count + 1, len(places))
            while at > 0 and squares[at - 1] > square:
                squares[at], places[at] = squares[at - 1], places[at - 1]
                at -= 1
            squares[at], places[at] = square, i
    return count
