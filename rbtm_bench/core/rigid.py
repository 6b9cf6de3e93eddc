"""Checks of single motions and matrices, compiled: asked for every registration.

``geometry`` has the same for stacks of motions; a call of numpy's costs more than the sums here.
"""

from __future__ import annotations

import math

import numpy as np

from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.types import Array

OUT_OF_PLANE = (2, 3, 4)
"""z, rx and ry among x, y, z, rx, ry, rz."""


@kernel
def rigidity(T: Array) -> float:
    """``geometry.rigidity_error`` of a float64 (4, 4)."""
    a, b, c, x = T[0, 0], T[0, 1], T[0, 2], T[0, 3]
    d, e, f, y = T[1, 0], T[1, 1], T[1, 2], T[1, 3]
    g, h, i, z = T[2, 0], T[2, 1], T[2, 2], T[2, 3]
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    total = determinant + x + y + z + T[3, 0] + T[3, 1] + T[3, 2] + T[3, 3]
    if not math.isfinite(total) or not determinant > 0.0:
        return np.inf
    off = max(abs(a * a + b * b + c * c - 1.0), abs(d * d + e * e + f * f - 1.0))
    off = max(off, abs(g * g + h * h + i * i - 1.0), abs(a * d + b * e + c * f))
    off = max(off, abs(a * g + b * h + c * i), abs(d * g + e * h + f * i))
    return max(off, abs(T[3, 0]), abs(T[3, 1]), abs(T[3, 2]), abs(T[3, 3] - 1.0))


@kernel
def apart(T: Array, other: Array) -> tuple[float, float]:
    """How far (m, rad) two motions (4, 4) from one frame are apart: the length and the rotation
    angle of inverse(T) other."""
    x, y, z = other[0, 3] - T[0, 3], other[1, 3] - T[1, 3], other[2, 3] - T[2, 3]
    R = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            R[i, j] = T[0, i] * other[0, j] + T[1, i] * other[1, j] + T[2, i] * other[2, j]
    a, b, c = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    sine = 0.5 * math.sqrt(a * a + b * b + c * c)
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    return math.sqrt(x * x + y * y + z * z), math.atan2(sine, cosine)


@kernel
def all_finite(points: Array) -> bool:
    """Whether points (N, D) have no NaN and no infinity."""
    for i in range(len(points)):
        for j in range(points.shape[1]):
            if not math.isfinite(points[i, j]):
                return False
    return True


@kernel
def symmetric_information(information: Array, planar: bool) -> Array:
    """Information (6, 6) of x, y, z, rx, ry, rz, symmetric to the last bit, which a product of
    matrices is not on every processor; in the plane without what leaves it."""
    out = np.zeros((6, 6))
    for i in range(6):
        if planar and i in OUT_OF_PLANE:
            continue
        for j in range(6):
            if planar and j in OUT_OF_PLANE:
                continue
            out[i, j] = 0.5 * (information[i, j] + information[j, i])
    return out
