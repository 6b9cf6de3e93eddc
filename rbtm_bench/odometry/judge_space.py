"""The judge's sums between clouds in space, compiled: matches, and the surfaces they lie on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.backends.space_index import SpaceIndex, nearest_in_space, neighbours_in_space
from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.types import Array


@kernel
def space_matches(
    target: SpaceIndex,
    source: Array,
    T: Array,
    radius: float,
    step: int,
) -> tuple[NDArray[np.int64], float]:
    """Of every ``step``-th source point (N, 3), moved by T (4, 4), the place of its match in the
    target or -1 (ceil(N / step),), and the squared distances of all matches (m^2)."""
    places = np.empty(-(-len(source) // step), np.int64)
    squares = 0.0
    for k in range(len(places)):
        a, b, c = source[k * step, 0], source[k * step, 1], source[k * step, 2]
        x = T[0, 0] * a + T[0, 1] * b + T[0, 2] * c + T[0, 3]
        y = T[1, 0] * a + T[1, 1] * b + T[1, 2] * c + T[1, 3]
        z = T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3]
        places[k], best = nearest_in_space(target, x, y, z, radius * radius)
        if places[k] >= 0:
            squares += best
    return places, squares


@kernel
def spreads(
    target: SpaceIndex,
    places: NDArray[np.int64],
    most: int,
) -> tuple[NDArray[np.int64], Array]:
    """How many neighbours within the width, at most ``most``, each of the target points at
    ``places`` (M,) has, itself included, and their scatter matrices (M, 3, 3) m^2."""
    counts = np.zeros(len(places), np.int64)
    scatter = np.zeros((len(places), 3, 3))
    near, squares = np.empty(most, np.int64), np.empty(most)
    for m in range(len(places)):
        count = neighbours_in_space(target, places[m], near, squares)
        counts[m] = count
        mean = np.zeros(3)
        for k in range(count):
            for i in range(3):
                mean[i] += target.points[near[k], i] / count
        for k in range(count):
            for i in range(3):
                for j in range(3):
                    first = target.points[near[k], i] - mean[i]
                    scatter[m, i, j] += first * (target.points[near[k], j] - mean[j]) / count
    return counts, scatter
