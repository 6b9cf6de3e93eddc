"""The sums behind the circular correlation, compiled: many pairs in one pass over the memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.kernels import reordering_kernel
from rbtm_bench.core.types import Array


@reordering_kernel
def circular_sums(rows: Array, columns: Array, first: NDArray[np.int64], count: int) -> Array:
    """Sums (C, count, 3) of columns (C, 3 B) with the rows (R, 3 B) first[j] ... first[j] + count
    - 1 of each: shared beams, and the real and imaginary part of u conj(v) over them.

    Descriptors are Re u, Im u and the mask of B beams, zero where undefined. A pair's bits do not
    depend on the others: whoever needs some of the same pairs has to ask here.
    """
    beams = rows.shape[1] // 3
    out = np.empty((len(columns), count, 3))
    for j in range(len(columns)):
        y = columns[j]
        for k in range(count):
            x = rows[first[j] + k]
            shared = real = imaginary = 0.0
            for b in range(beams):
                u, v, p, q = x[b], x[beams + b], y[b], y[beams + b]
                shared += x[2 * beams + b] * y[2 * beams + b]
                real += u * p + v * q
                imaginary += v * p - u * q
            out[j, k, 0], out[j, k, 1], out[j, k, 2] = shared, real, imaginary
    return out
