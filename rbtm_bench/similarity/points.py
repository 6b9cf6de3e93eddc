"""What similarities of points under the initial guess share: a fixed-size sample of a scan's
points, sorted, and compiled searches among them.

The points of a descriptor are sorted along the axis of their largest spread. Those of the other
scan come in the order of *their* axis, so that under a small rotation the place of one in the
sorted list is a few steps from that of the one before: no tree, no binary search.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.geometry import voxel_downsample
from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.kinds import Distance, VoxelSize
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.similarity.base import Descriptor, Similarity

Points = NDArray[np.float32]

HEADER = 2
"""Values of a descriptor before its points: their number, and the axis they are sorted by."""


class PointSimilarity(Similarity):
    """A similarity of two scans' points, the new scan's moved by the guess.

    A descriptor is (2 + 3 P,) float32: the number of points, their sorting axis, then x, y, z (m,
    sensor frame) of P points, NaN after the last. Of a scan with B beams all points are taken
    (P = B); of any other at most ``points``: in space those with ``min_height_m`` <= z <
    ``max_height_m`` (None: no limit; ground moves with the sensor and agrees under any guess),
    averaged in voxels of ``voxel_size`` m (0: none), and of these evenly many in the voxels' order.

    Points further apart than ``radius`` m are no neighbours. A scan of fewer than ``min_points``
    has no score.

    A plug-in writes ``compare``. Raises ``ConfigError`` for an upside-down height band.
    """

    needs_guess = True

    def __init__(
        self,
        radius: Distance = 0.3,
        min_points: Annotated[int, Ge(1)] = 20,
        points: Annotated[int, Ge(1)] = 1000,
        voxel_size: VoxelSize = 0.0,
        min_height_m: float | None = None,
        max_height_m: float | None = None,
    ) -> None:
        low = -np.inf if min_height_m is None else min_height_m
        high = np.inf if max_height_m is None else max_height_m
        if high <= low:
            raise ConfigError(
                f"similarity.max_height_m={max_height_m}: expected more than "
                f"min_height_m={min_height_m}"
            )
        self.radius, self.min_points, self.points = radius, min_points, points
        self.voxel_size, self.band_m = voxel_size, (low, high)
        tiny = descriptor_of(np.eye(3), 3)
        self.scores(tiny[None], tiny)  # compiles the kernels: never on a scan's time

    def describe(self, scan: Scan) -> Points:
        if scan.ranges is not None:
            return descriptor_of(scan.points, len(scan.ranges))
        return descriptor_of(self._sample(scan), self.points)

    def curve(self, descriptor: Descriptor) -> None:
        """None: it is the points themselves."""

    def _sample(self, scan: Scan) -> Array:
        points = scan.points
        if not scan.planar:
            low, high = self.band_m
            points = points[(points[:, 2] >= low) & (points[:, 2] < high)]
        points = voxel_downsample(points, self.voxel_size)
        if len(points) <= self.points:
            return points
        return points[np.arange(self.points) * len(points) // self.points]

    def scores(self, window: Descriptor, descriptor: Descriptor) -> Array:
        """Scores (W,) under no motion."""
        return self.scores_under(window, descriptor, np.tile(np.eye(4), (len(window), 1, 1)))

    def scores_under(self, window: Descriptor, descriptor: Descriptor, motions: Array) -> Array:
        return self.compare(
            np.ascontiguousarray(window),
            np.ascontiguousarray(descriptor),
            np.ascontiguousarray(motions, dtype=np.float64),
        )

    def matrix(self, descriptors: Descriptor) -> Array:
        """Scores (N, N) of all pairs under no motion: half of them, as they are symmetric."""
        out = np.full((len(descriptors), len(descriptors)), np.nan)
        for j in range(len(descriptors)):
            out[: j + 1, j] = out[j, : j + 1] = self.scores(descriptors[: j + 1], descriptors[j])
        return out

    @abstractmethod
    def compare(self, window: Points, descriptor: Points, motions: Array) -> Array:
        """Scores (W,) of descriptors (W, D) and (D,) under T_model_scan (W, 4, 4): symmetric, and
        NaN for scans of too few points and for motions that are not finite."""


def descriptor_of(points: Array, most: int) -> Points:
    """Points (N, 3) m as a descriptor (2 + 3 ``most``,). Raises ``DataError`` if N > ``most``."""
    count = len(points)
    if count > most:
        raise DataError(f"a scan of {most} beams has {count} points: expected one a beam at most")
    out = np.full(HEADER + 3 * most, np.nan, dtype=np.float32)
    axis = int(np.argmax(np.ptp(points, axis=0))) if count else 0
    out[0], out[1] = count, axis
    order = np.argsort(points[:, axis], kind="stable")
    out[HEADER : HEADER + 3 * count] = points[order].ravel()
    return out


@kernel
def points_of(descriptor: Points) -> tuple[Points, int]:
    """The points (N, 3) of a descriptor and the axis that they are sorted by."""
    count, axis = int(descriptor[0]), int(descriptor[1])
    return descriptor[2 : 2 + 3 * count].reshape(count, 3), axis


@kernel
def walk(points: Points, axis: int, along: float, place: int) -> int:
    """The first of the sorted points that is not before ``along``, searched from ``place`` on."""
    while place < len(points) and points[place, axis] < along:
        place += 1
    while place > 0 and points[place - 1, axis] >= along:
        place -= 1
    return place


@kernel
def moved(T: Array, p: Points) -> tuple[float, float, float]:
    """The point p (3,) moved by T (4, 4)."""
    return (
        T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3],
        T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3],
        T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3],
    )


@kernel
def inverse_of(T: Array) -> Array:
    """The inverse of a rigid motion (4, 4)."""
    out = np.zeros((4, 4))
    out[3, 3] = 1.0
    for i in range(3):
        for j in range(3):
            out[i, j] = T[j, i]
            out[i, 3] -= T[j, i] * T[j, 3]
    return out


@kernel
def nearest(
    points: Points, axis: int, x: float, y: float, z: float, radius: float, place: int
) -> tuple[int, float]:
    """The number of the point nearest to (x, y, z) and its squared distance; (-1, radius^2) if
    none is nearer than ``radius``. ``place`` is where ``walk`` put it."""
    along = x if axis == 0 else (y if axis == 1 else z)
    best, number = radius * radius, -1
    # one way, then the other: taking turns visits fewer points, but the processor cannot foresee
    # which is next, and that costs more
    k = place
    while k < len(points) and (points[k, axis] - along) ** 2 < best:
        square = (points[k, 0] - x) ** 2 + (points[k, 1] - y) ** 2 + (points[k, 2] - z) ** 2
        if square < best:
            best, number = square, k
        k += 1
    k = place - 1
    while k >= 0 and (points[k, axis] - along) ** 2 < best:
        square = (points[k, 0] - x) ** 2 + (points[k, 1] - y) ** 2 + (points[k, 2] - z) ** 2
        if square < best:
            best, number = square, k
        k -= 1
    return number, best
