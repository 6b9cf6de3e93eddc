"""Inner products of descriptors whose bits depend on the two vectors alone."""

from __future__ import annotations

from rbtm_bench.core.kernels import broadcasting
from rbtm_bench.core.types import Array


@broadcasting("(n),(n)->()", "void(float64[:], float64[:], float64[:])")
def inner(x: Array, y: Array, out: Array) -> None:
    """``inner(x, y)``: sums (...) over the last axis of x (..., N) times y (..., N), whose leading
    axes broadcast, as ``np.vecdot`` for real numbers.

    That asks a library for every pair, which on processors without AVX adds in another order where
    the vectors lie otherwise in memory. Here the order is written down: eight sums, then one.
    """
    count = len(x)
    whole = count - count % 8
    a = b = c = d = e = f = g = h = 0.0
    for i in range(0, whole, 8):
        a += x[i] * y[i]
        b += x[i + 1] * y[i + 1]
        c += x[i + 2] * y[i + 2]
        d += x[i + 3] * y[i + 3]
        e += x[i + 4] * y[i + 4]
        f += x[i + 5] * y[i + 5]
        g += x[i + 6] * y[i + 6]
        h += x[i + 7] * y[i + 7]
    for i in range(whole, count):
        a += x[i] * y[i]
    out[0] = ((a + e) + (c + g)) + ((b + f) + (d + h))
