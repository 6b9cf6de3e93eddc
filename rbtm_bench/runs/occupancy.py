"""The map of a planar run as a grid: which cells the scans found occupied, which they saw through.

A counting model (Haehnel, Schulz and Burgard 2003, "Mobile robot mapping in populated
environments"), with a cell counted once a scan however many beams meet in it: as hit if a point
of the scan lies in it, else as passed if a beam on its way to a point crosses it. The share
hits / (hits + passed) is then the share of the scans which saw the cell that found it occupied.
A beam without a return says nothing: whether it met nothing or was lost is not known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.geometry import transform
from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.base import Dataset

CELLS = 8_000_000
"""Most cells of a grid (140 m x 140 m at 5 cm). A larger map gets cells twice as wide, or four
times, and so on."""
TRIMMED = 0.1
"""Percent of the map's points at each side that need not lie on the grid: stray returns, and
what a registration gone wrong threw far away."""

Counts = NDArray[np.uint32]


@dataclass(frozen=True, eq=False)
class Occupancy:
    """``hits`` and ``passed`` (rows, columns): scans that found a cell occupied, and that only
    saw through it. ``corner`` (2,) m is the outer corner of cell [0, 0]: x grows with the column,
    y with the row. ``cell`` m is a cell's side."""

    hits: Counts
    passed: Counts
    corner: Array
    cell: float

    @property
    def share(self) -> Array:
        """Share (rows, columns) of the scans which saw a cell that found it occupied; NaN where
        none saw it."""
        seen = self.hits + self.passed
        return np.where(seen > 0, self.hits / np.maximum(seen, 1), np.nan)

    def arrays(self) -> dict[str, Any]:
        """As named arrays, to be kept."""
        return {
            "hits": self.hits.astype(np.min_scalar_type(int(self.hits.max(initial=0)))),
            "passed": self.passed.astype(np.min_scalar_type(int(self.passed.max(initial=0)))),
            "corner": self.corner,
            "cell": np.array(self.cell),
        }


def build_grid(
    dataset: Dataset, T_world_scans: Array, points: NDArray[Any], cell: float
) -> Occupancy:
    """The grid of a planar data set's N scans at their poses (N, 4, 4).

    ``points`` (M, 3) m are the map's, which say how large the grid must be: it holds every pose
    and all of them but stray ones. Beams are followed by Amanatides and Woo 1987.
    """
    corner, shape, cell = _extent(T_world_scans[:, :2, 3], points[:, :2], cell)
    hits, passed = np.zeros(shape, np.uint32), np.zeros(shape, np.uint32)
    seen = np.full(shape, -1, np.int32)
    for index, (scan, T) in enumerate(zip(dataset, T_world_scans, strict=True)):
        ends = (transform(T, scan.points)[:, :2] - corner) / cell
        _add(hits, passed, seen, index, (T[:2, 3] - corner) / cell, np.ascontiguousarray(ends))
    return Occupancy(hits, passed, corner, cell)


def _extent(
    poses: Array, points: NDArray[Any], cell: float
) -> tuple[Array, tuple[int, int], float]:
    """Corner (2,) m, shape (rows, columns) and cell m of a grid, one free cell around it."""
    held = poses
    if len(points):
        inner = np.percentile(points, [TRIMMED, 100 - TRIMMED], axis=0, method="nearest")
        held = np.vstack([poses, inner])
    low, high = held.min(axis=0), held.max(axis=0)
    while True:
        first = np.floor(low / cell) - 1
        columns, rows = (np.floor(high / cell) - first + 2).astype(np.int64)
        if rows * columns <= CELLS:
            return first * cell, (int(rows), int(columns)), cell
        cell *= 2


@kernel
def _add(hits: Any, passed: Any, seen: Any, scan: int, start: Any, ends: Any) -> None:
    """Count a scan: ``start`` (2,) and ``ends`` (K, 2) in cells. ``seen`` remembers the scan that
    last counted a cell."""
    rows, columns = hits.shape
    for x, y in ends:
        i, j = math.floor(y), math.floor(x)
        if 0 <= i < rows and 0 <= j < columns and seen[i, j] != scan:
            seen[i, j] = scan
            hits[i, j] += 1
    for x, y in ends:
        _follow(passed, seen, scan, start, x, y)


@kernel
def _follow(passed: Any, seen: Any, scan: int, start: Any, x: float, y: float) -> None:
    """Count the cells from the start to the cell before the end. Cells off the grid are not."""
    rows, columns = passed.shape
    i, j = math.floor(start[1]), math.floor(start[0])
    dx, dy = x - start[0], y - start[1]
    step_j, step_i = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    # in shares of the beam: where it next crosses a column's and a row's border, and how far on
    # the crossing after that is
    next_x = (j + (dx > 0) - start[0]) / dx if dx != 0 else np.inf
    next_y = (i + (dy > 0) - start[1]) / dy if dy != 0 else np.inf
    each_x = abs(1 / dx) if dx != 0 else np.inf
    each_y = abs(1 / dy) if dy != 0 else np.inf
    crossings = abs(math.floor(x) - j) + abs(math.floor(y) - i)
    for _ in range(crossings):
        if 0 <= i < rows and 0 <= j < columns and seen[i, j] != scan:
            seen[i, j] = scan
            passed[i, j] += 1
        if next_x < next_y:
            next_x += each_x
            j += step_j
        else:
            next_y += each_y
            i += step_i
