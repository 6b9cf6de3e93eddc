"""The map that a trajectory makes of its scans, thin enough to keep and draw."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.geometry import transform
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.base import Dataset

BATCH = 200_000
"""Points gathered before they are thinned: bounds the memory."""


def build_map(dataset: Dataset, T_world_scans: Array, resolution: float) -> NDArray[np.float32]:
    """Points (M, 3) m in the world: one, the first seen, for every cell of ``resolution`` m.

    ``T_world_scans`` (N, 4, 4) are the poses of the data set's N scans.
    """
    cells: NDArray[np.int64] = np.zeros((0, 3), dtype=np.int64)
    kept: Array = np.zeros((0, 3))
    waiting: list[Array] = []
    for index, (scan, T) in enumerate(zip(dataset, T_world_scans, strict=True)):
        waiting.append(transform(T, scan.points))
        if index == len(T_world_scans) - 1 or sum(map(len, waiting)) > BATCH:
            points = np.concatenate([kept, *waiting])
            cells = np.floor(points / resolution).astype(np.int64)
            _, first = np.unique(cells, axis=0, return_index=True)
            kept, waiting = points[np.sort(first)], []
    return kept.astype(np.float32)
