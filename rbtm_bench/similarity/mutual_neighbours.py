"""The share of points that are each other's nearest neighbours under the initial guess."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.types import Array
from rbtm_bench.similarity.points import (
    Points,
    PointSimilarity,
    inverse_of,
    moved,
    nearest,
    points_of,
    walk,
)

TIE = 1e-9
"""m: neighbours nearer than the nearest by less than this are as near; rounding, and points that
coincide, must not break a pair."""


class MutualNeighbours(PointSimilarity):
    """Points p of one scan and q of the other are a mutual pair if, under the guessed motion, they
    are nearer than ``radius`` m, and no point of either scan is nearer to its partner. The score is
    the share of all points of both scans that are in such a pair: in [0, 1]; symmetric.

    Stricter than ``overlap``: a wall seen densely by one scan and thinly by the other gives a
    point of the thin one a partner, and most of the dense one none.

    The parameters are those of ``PointSimilarity``.
    """

    def compare(self, window: Points, descriptor: Points, motions: Array) -> Array:
        return _scores(window, descriptor, motions, self.radius, self.min_points)


@kernel
def _scores(
    window: Points, descriptor: Points, motions: Array, radius: float, min_points: int
) -> Array:
    out = np.full(len(window), np.nan)
    scan, scan_axis = points_of(descriptor)
    for w in range(len(window)):
        model, model_axis = points_of(window[w])
        T = motions[w]
        if min(len(model), len(scan)) < min_points or not np.isfinite(T).all():
            continue
        partner, far = _partners(scan, model, model_axis, T, radius)
        back, far_back = _partners(model, scan, scan_axis, inverse_of(T), radius)
        mutual = _mutual(partner, far, far_back) + _mutual(back, far_back, far)
        out[w] = mutual / (len(scan) + len(model))
    return out


@kernel
def _partners(
    source: Points, target: Points, axis: int, T: Array, radius: float
) -> tuple[NDArray[np.int64], Array]:
    """Each source point's nearest target point (-1: none within the radius) and its distance."""
    partner = np.empty(len(source), dtype=np.int64)
    distance = np.empty(len(source))
    place = 0
    for i in range(len(source)):
        x, y, z = moved(T, source[i])
        along = x if axis == 0 else (y if axis == 1 else z)
        place = walk(target, axis, along, place)
        partner[i], square = nearest(target, axis, x, y, z, radius, place)
        distance[i] = np.sqrt(square)
    return partner, distance


@kernel
def _mutual(partner: NDArray[np.int64], distance: Array, partners_distance: Array) -> int:
    """How many points have a partner that has no nearer one."""
    count = 0
    for i in range(len(partner)):
        if partner[i] >= 0 and distance[i] <= partners_distance[partner[i]] + TIE:
            count += 1
    return count
