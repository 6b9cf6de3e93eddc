"""Our own running map, for backends whose library has none: the mean of the points in each cell."""

from __future__ import annotations

import numpy as np

from rbtm_bench.backends.base import Backend, MapLimits, Placed, Prepared, RunningMap, TargetKey
from rbtm_bench.core.geometry import inverse, transform
from rbtm_bench.core.types import Array

BITS = 21
"""Of a cell's number along each axis: a million cells either way."""
CELLS = 3.0
"""Cells in the backend's correspondence distance, unless their size is given."""


class VoxelMap(RunningMap):
    """Cells of ``cell_size`` m (None: a third of the correspondence distance), each with the mean
    of all points that fell into it since it was last forgotten. The backend is given all of them,
    prepared anew after every scan that was added, in the frame of that scan."""

    def __init__(self, backend: Backend, limits: MapLimits, cell_size: float | None) -> None:
        self._backend, self._limits = backend, limits
        self._size = cell_size or backend.max_correspondence_distance / CELLS
        self._cells = np.empty(0, np.int64)
        self._sums = np.empty((0, 4))  # x, y, z and how many points
        self._used = np.empty(0, np.int64)
        self._scans, self._newest, self._planar = 0, np.eye(4), True
        self._key: TargetKey = ()
        self._target: Prepared | None = None

    def insert(self, scan: Prepared, T_map_scan: Array) -> None:
        points = transform(T_map_scan, scan.points)
        self._scans, self._newest, self._target = self._scans + 1, T_map_scan, None
        self._key = scan.key
        self._planar = self._planar and scan.planar
        cells, group = np.unique(self._numbers(points), return_inverse=True)
        sums = [np.bincount(group, weights=w) for w in (*points.T, np.ones(len(points)))]
        every, place = np.unique(np.concatenate([self._cells, cells]), return_inverse=True)
        old, new = place[: len(self._cells)], place[len(self._cells) :]
        total, used = np.zeros((len(every), 4)), np.zeros(len(every), np.int64)
        total[old], used[old] = self._sums, self._used
        total[new] += np.stack(sums, axis=1)
        used[new] = self._scans
        off = total[:, :3] / total[:, 3:] - T_map_scan[:3, 3]
        kept = np.linalg.norm(off, axis=1) <= self._limits.max_range
        kept &= used > self._scans - self._limits.horizon
        self._cells, self._sums, self._used = every[kept], total[kept], used[kept]

    def target(self) -> Prepared:
        if self._target is None:
            T_newest_map = inverse(self._newest)
            points = transform(T_newest_map, self._sums[:, :3] / self._sums[:, 3:])
            whole = Prepared(points, self._planar, None, self._key)
            built = self._backend.merge([(whole, np.eye(4))])
            self._target = Placed(built, T_newest_map)
        return self._target

    def _numbers(self, points: Array) -> Array:
        """One whole number for the cell of each point (N, 3) m."""
        x, y, z = (np.floor(points / self._size).astype(np.int64) + (1 << BITS - 1)).T
        numbers: Array = (x << 2 * BITS) + (y << BITS) + z
        return numbers
