"""The overlap of two scans under the initial guess: what a similarity of descriptors stands for."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge

from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.kinds import Distance, VoxelSize
from rbtm_bench.core.types import Array
from rbtm_bench.similarity.points import (
    Points,
    PointSimilarity,
    inverse_of,
    moved,
    points_of,
    walk,
)


class Overlap(PointSimilarity):
    """The share of a scan's points with a point of the other nearer than ``radius`` m, under the
    guessed motion, taken in both directions: their ``mean``, or their ``minimum``, which asks
    that neither scan sees much that the other does not. In [0, 1]; symmetric.

    The other parameters say which points count: see ``PointSimilarity``.
    """

    def __init__(
        self,
        radius: Distance = 0.3,
        directions: Literal["mean", "minimum"] = "mean",
        min_points: Annotated[int, Ge(1)] = 20,
        points: Annotated[int, Ge(1)] = 1000,
        voxel_size: VoxelSize = 0.0,
        min_height_m: float | None = None,
        max_height_m: float | None = None,
    ) -> None:
        self.directions = directions
        super().__init__(radius, min_points, points, voxel_size, min_height_m, max_height_m)

    def compare(self, window: Points, descriptor: Points, motions: Array) -> Array:
        shares = _shares(window, descriptor, motions, self.radius, self.min_points)
        return shares.mean(axis=1) if self.directions == "mean" else shares.min(axis=1)


@kernel
def _shares(
    window: Points, descriptor: Points, motions: Array, radius: float, min_points: int
) -> Array:
    """The share of the new scan's points near the model's, and the other way round (W, 2)."""
    out = np.full((len(window), 2), np.nan)
    scan, scan_axis = points_of(descriptor)
    for w in range(len(window)):
        model, model_axis = points_of(window[w])
        T = motions[w]
        if min(len(model), len(scan)) < min_points or not np.isfinite(T).all():
            continue
        out[w, 0] = _share(scan, model, model_axis, T, radius)
        out[w, 1] = _share(model, scan, scan_axis, inverse_of(T), radius)
    return out


@kernel
def _share(source: Points, target: Points, axis: int, T: Array, radius: float) -> float:
    near, place = 0, 0
    for i in range(len(source)):
        x, y, z = moved(T, source[i])
        along = x if axis == 0 else (y if axis == 1 else z)
        place = walk(target, axis, along, place)
        near += _has_neighbour(target, axis, x, y, z, radius, place)
    return near / len(source)


@kernel
def _has_neighbour(
    points: Points, axis: int, x: float, y: float, z: float, radius: float, place: int
) -> bool:
    """Whether any point is nearer to (x, y, z) than ``radius``: the first such will do."""
    along = x if axis == 0 else (y if axis == 1 else z)
    square = radius * radius
    k = place
    while k < len(points) and points[k, axis] - along < radius:
        dx, dy, dz = points[k, 0] - x, points[k, 1] - y, points[k, 2] - z
        if dx * dx + dy * dy + dz * dz < square:
            return True
        k += 1
    k = place - 1
    while k >= 0 and along - points[k, axis] < radius:
        dx, dy, dz = points[k, 0] - x, points[k, 1] - y, points[k, 2] - z
        if dx * dx + dy * dy + dz * dz < square:
            return True
        k -= 1
    return False
