"""The judge's sums between planar scans, compiled: matches, and normals that hold the motion."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.backends.plane_index import nearest
from rbtm_bench.core.kernels import kernel, reordering_kernel
from rbtm_bench.core.types import Array

COUNT, SQUARES, USED, LEVER, MATRIX = 0, 1, 2, 3, 4
"""Places in the sums: inliers, their squared distances (m^2), matches with a normal, the lever of
``Localizability`` (m), and its matrix (3, 3) row by row."""
SUMS = 13

MIN_SURFACE = 3
"""Fewer target points than this, the matched one included, have no normal."""
MAX_MATCHES = 200
"""Matched points, spread evenly over the inliers, that the localizability is computed from."""


@reordering_kernel
def _scatter(
    along: Array, across: Array, first: int, last: int, place: int, square: float
) -> tuple[float, float, float, float]:
    """How many points of first ... last - 1 lie within the root of ``square`` of the one at
    ``place``, and their scatter (m^2): along, between, across."""
    x, y = along[place], across[place]
    n = sx = sy = xx = xy = yy = 0.0
    for k in range(first, last):
        dx, dy = along[k] - x, across[k] - y
        inside = 1.0 if dx * dx + dy * dy < square else 0.0
        dx, dy = dx * inside, dy * inside
        n += inside
        sx += dx
        sy += dy
        xx += dx * dx
        xy += dx * dy
        yy += dy * dy
    return n, xx - sx * sx / n, xy - sx * sy / n, yy - sy * sy / n


@kernel
def _normal(xx: float, xy: float, yy: float) -> tuple[float, float]:
    """The unit vector of least spread: half the angle of (xx - yy, 2 xy), turned by 90 degrees."""
    a, b = xx - yy, 2.0 * xy
    length = math.sqrt(a * a + b * b)
    if length == 0.0:
        return 0.0, 1.0
    if a >= 0.0:
        x = math.sqrt(0.5 * (1.0 + a / length))
        return -0.5 * b / (length * x), x
    y = math.sqrt(0.5 * (1.0 - a / length))
    return -y, 0.5 * b / (length * y)


@kernel
def _matches(
    along: Array,
    across: Array,
    start: NDArray[np.int64],
    frame: Array,
    source: Array,
    T: Array,
    square: float,
    places: NDArray[np.int64],
) -> tuple[float, float]:
    """Fill ``places`` (N,) with the match of every source point nearer than the root of ``square``,
    -1 for none; how many those are, and their squared distances (m^2)."""
    c, s, x, y = T[0, 0], T[1, 0], T[0, 3], T[1, 3]
    count, squares, last, turned = 0.0, 0.0, -1, frame[2] != 0.0
    for i in range(len(source)):
        u = c * source[i, 0] - s * source[i, 1] + x
        v = s * source[i, 0] + c * source[i, 1] + y
        if turned:
            u, v = v, u
        best, place = square, -1
        if last >= 0:  # a neighbouring beam's match is a good bound
            bound = (along[last] - u) ** 2 + (across[last] - v) ** 2
            if bound < best:
                best, place = bound, last
        places[i], best = nearest(along, across, start, frame, u, v, best, place)
        if places[i] >= 0:
            count += 1.0
            squares += best
            last = places[i]
    return count, squares


@kernel
def plane_sums(
    target: Array,
    start: NDArray[np.int64],
    frame: Array,
    source: Array,
    T: Array,
    radius: float,
) -> Array:
    """Sums (13,), see ``COUNT`` ... ``MATRIX``, of source points (N, 2) or (N, 3) moved by T (4, 4)
    to those of a ``PlaneIndex``. At most ``MAX_MATCHES`` matches, spread evenly, get a normal; of
    fewer than ``MIN_SURFACE`` points within ``radius`` m of a target point there is none."""
    along, across = target[0], target[1]
    c, s, square, turned = T[0, 0], T[1, 0], radius * radius, frame[2] != 0.0
    places = np.empty(len(source), np.int64)
    out = np.zeros(SUMS)
    out[COUNT], out[SQUARES] = _matches(along, across, start, frame, source, T, square, places)
    step = max(1, -(-int(out[COUNT]) // MAX_MATCHES))
    H, seen = np.zeros((3, 3)), 0
    reach = _reaches(along, radius)
    lever = 0.0
    for i in range(len(source)):
        place = places[i]
        if place < 0:
            continue
        seen += 1
        if (seen - 1) % step:
            continue
        n, xx, xy, yy = _scatter(along, across, reach[place, 0], reach[place, 1], place, square)
        if n < MIN_SURFACE:
            continue
        out[USED] += 1.0
        nx, ny = _normal(xx, xy, yy)
        if turned:
            nx, ny = ny, nx
        a, b = c * nx + s * ny, c * ny - s * nx  # the normal in the source's frame
        px, py = source[i, 0], source[i, 1]
        r = px * b - py * a
        lever += px * px + py * py
        H[0, 0] += a * a
        H[0, 1] += a * b
        H[1, 1] += b * b
        H[0, 2] += a * r
        H[1, 2] += b * r
        H[2, 2] += r * r
    used = out[USED]
    out[LEVER] = 1.0
    if used > 0.0:
        lever = math.sqrt(lever / used)
        lever = lever if lever > 0.0 else 1.0
        out[LEVER] = lever
        H[0, 2] /= lever
        H[1, 2] /= lever
        H[2, 2] /= lever * lever
        for i in range(3):
            for j in range(3):
                out[MATRIX + 3 * i + j] = H[min(i, j), max(i, j)] / used
    return out


@kernel
def _reaches(along: Array, radius: float) -> NDArray[np.int64]:
    """For every point (N, 2) the places between which others can lie within ``radius`` m."""
    reach = np.empty((len(along), 2), np.int64)
    first = last = 0
    for k in range(len(along)):
        while along[k] - along[first] >= radius:
            first += 1
        while last < len(along) and along[last] - along[k] < radius:
            last += 1
        reach[k, 0], reach[k, 1] = first, last
    return reach
