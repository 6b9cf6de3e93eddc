"""The nearest of planar points, exactly, compiled: a search along one axis.

Points sorted along their axis of larger spread lie in buckets of that axis, so that a search begins
where it has to; it ends where the axis alone is farther than the best so far.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.types import Array

MOST_IN_A_BUCKET = 64
"""Beyond this a bucket is sorted by a library, which needs no look at every pair."""


class PlaneIndex(NamedTuple):
    """Planar points sorted along an axis. ``points`` (2, N) m along and across it; ``start``
    (N + 1,) where each of N buckets begins; ``frame`` (3,): where the first begins (m), buckets per
    metre, and 1 if the axis is y. (Kernels take the three by themselves: a tuple costs more than
    their sums.)"""

    points: Array
    start: NDArray[np.int64]
    frame: Array


def plane_index(points: Array) -> PlaneIndex:
    """Points (N, 2) or (N, 3) m, by their x and y; N >= 1."""
    return PlaneIndex(*_sorted(points))


@kernel
def _sorted(points: Array) -> tuple[Array, NDArray[np.int64], Array]:
    count = len(points)
    low, high = points[0, :2].copy(), points[0, :2].copy()
    for i in range(count):
        for j in range(2):
            low[j], high[j] = min(low[j], points[i, j]), max(high[j], points[i, j])
    axis = 1 if high[1] - low[1] > high[0] - low[0] else 0
    span, first = high[axis] - low[axis], low[axis]
    per_metre = count / span if span > 1e-9 else 0.0
    start = np.zeros(count + 1, np.int64)
    bucket = np.empty(count, np.int64)
    for i in range(count):
        bucket[i] = min(count - 1, int((points[i, axis] - first) * per_metre))
        start[bucket[i] + 1] += 1
    fullest = start.max()
    for b in range(count):
        start[b + 1] += start[b]
    order = np.empty(count, np.int64)
    if fullest > MOST_IN_A_BUCKET:
        order[:] = np.argsort(points[:, axis], kind="mergesort")
    else:
        place = start.copy()
        for i in range(count):
            order[place[bucket[i]]] = i
            place[bucket[i]] += 1
        for k in range(1, count):  # points of a bucket are in the order of sensing: nearly sorted
            i, j = order[k], k - 1
            while j >= 0 and points[order[j], axis] > points[i, axis]:
                order[j + 1] = order[j]
                j -= 1
            order[j + 1] = i
    ordered = np.empty((2, count))
    for k in range(count):
        ordered[0, k], ordered[1, k] = points[order[k], axis], points[order[k], 1 - axis]
    return ordered, start, np.array([first, per_metre, float(axis)])


@kernel
def nearest(
    along: Array,
    across: Array,
    start: NDArray[np.int64],
    frame: Array,
    u: float,
    v: float,
    best: float,
    place: int,
) -> tuple[int, float]:
    """The place of the point nearest to (u along, v across) m, and its squared distance (m^2):
    ``place`` and ``best`` as they are given where none is nearer."""
    count = len(along)
    bucket = (u - frame[0]) * frame[1]
    k = 0
    if bucket >= count:
        k = count
    elif bucket > 0.0:
        k = start[int(bucket)]
    j = k
    while j < count:
        d = along[j] - u
        if d >= 0.0 and d * d >= best:
            break
        square = d * d + (across[j] - v) ** 2
        if square < best:
            best, place = square, j
        j += 1
    j = k - 1
    while j >= 0:
        d = along[j] - u
        if d <= 0.0 and d * d >= best:
            break
        square = d * d + (across[j] - v) ** 2
        if square < best:
            best, place = square, j
        j -= 1
    return place, best
