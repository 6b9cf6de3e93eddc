"""How likely a point lies at each place near a planar scan: the table that a correlative search
adds up, with maxima over blocks of it as upper bounds (Olson 2009; Hess et al. 2016)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.types import Array

Bytes = NDArray[np.uint8]

FULL = 255
"""What a cell's likelihood of 1 is written as: sums of bytes are exact in any order."""
REACH = 3.0
"""Standard deviations from the nearest point, beyond which the likelihood counts as 0."""
BITS = (0, 2, 4)
"""Blocks of a level are 2^bits cells wide: 1, 4, 16."""
WIDEST = 16
MOST_CELLS = 40_000_000
"""Of a field: at 5 cm a square of 316 m."""


class Field(NamedTuple):
    """The likelihood of square cells of ``size`` m, the first of them at ``corner`` (x, y) m.

    ``levels`` hold, for blocks s = 1, 4 and 16 cells wide, [y % s, x % s, y // s, x // s]: the
    highest likelihood (0 to 255) of the s x s cells from cell (x, y) on. Blocks side by side lie
    side by side in memory, wherever the first of them begins. The widest are empty until a window
    is so large that they are asked for (``with_widest``)."""

    corner: tuple[float, float]
    size: float
    levels: tuple[Bytes, Bytes, Bytes]


def field_of(points: Array, size: float, sigma: float) -> Field | None:
    """The field of points (N, 2 or 3) m: exp(-d^2 / (2 sigma^2)) at a cell's middle, d m from the
    nearest of them. None where they lie too far apart for a table."""
    margin = math.ceil(REACH * sigma / size)
    low = np.floor(points[:, :2].min(axis=0) / size) - margin - WIDEST
    high = np.floor(points[:, :2].max(axis=0) / size) + margin + 1
    width, height = (np.ceil((high - low) / WIDEST) * WIDEST).tolist()
    if width * height > MOST_CELLS:
        return None
    corner = float(low[0]) * size, float(low[1]) * size
    cells = np.zeros((int(height), int(width)), np.uint8)
    smear(points, corner[0], corner[1], size, sigma, margin, cells)
    none = np.empty((WIDEST, WIDEST, 0, 0), np.uint8)
    return Field(corner, size, (cells[None, None], interleaved(wider(cells, 1, 2), 4), none))


def with_widest(field: Field) -> Field:
    """The same with its widest blocks."""
    cells, middle, widest = field.levels
    if widest.size:
        return field
    plain = middle.transpose(2, 0, 3, 1).reshape(cells.shape[2:])
    return field._replace(levels=(cells, middle, interleaved(wider(plain, 4, 8), WIDEST)))


@kernel
def smear(
    points: Array, x0: float, y0: float, size: float, sigma: float, margin: int, cells: Bytes
) -> None:
    """Write the likelihood around each point into ``cells`` (H, W), the highest where they meet."""
    along_x, along_y = np.empty(2 * margin + 1), np.empty(2 * margin + 1)
    for p in range(len(points)):
        x, y = (points[p, 0] - x0) / size, (points[p, 1] - y0) / size
        left, low = int(x) - margin, int(y) - margin
        for k in range(2 * margin + 1):
            dx, dy = (left + k + 0.5 - x) * size / sigma, (low + k + 0.5 - y) * size / sigma
            along_x[k], along_y[k] = FULL * np.exp(-0.5 * dx * dx), np.exp(-0.5 * dy * dy)
        for j in range(2 * margin + 1):
            for i in range(2 * margin + 1):
                value = np.uint8(along_x[i] * along_y[j] + 0.5)
                if value > cells[low + j, left + i]:
                    cells[low + j, left + i] = value


@kernel
def wider(cells: Bytes, first: int, second: int) -> Bytes:
    """Maxima over blocks that many cells wider, twice: each cell with the one ``first`` further on,
    then with the one ``second`` further on, along both axes; none beyond the edge."""
    height, width = cells.shape
    out = cells.copy()
    for step in (first, second):
        for j in range(height):
            row = out[j]
            for i in range(width - step):
                row[i] = max(row[i], row[i + step])
        for j in range(height - step):
            row, other = out[j], out[j + step]
            for i in range(width):
                row[i] = max(row[i], other[i])
    return out


@kernel
def interleaved(cells: Bytes, block: int) -> Bytes:
    """Cells (H, W) as [y % block, x % block, y // block, x // block]."""
    height, width = cells.shape[0] // block, cells.shape[1] // block
    out = np.empty((block, block, height, width), np.uint8)
    for j in range(height):
        for b in range(block):
            row = cells[j * block + b]
            for i in range(width):
                for a in range(block):
                    out[b, a, j, i] = row[i * block + a]
    return out
