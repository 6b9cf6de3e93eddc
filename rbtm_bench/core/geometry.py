"""Rigid motions in the plane and in space: small helpers on 4x4 float64 matrices."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.types import Array

_IDENTITY = np.eye(4)


def se2(x: float, y: float, theta: float) -> Array:
    """The 4x4 pose of a planar motion: x, y in m, theta in rad about z."""
    T = _IDENTITY.copy()
    c, s = np.cos(theta), np.sin(theta)
    T[0, 0], T[0, 1], T[1, 0], T[1, 1] = c, -s, s, c
    T[0, 3], T[1, 3] = x, y
    return T


def se3(translation: ArrayLike, rotation: ArrayLike) -> Array:
    """The 4x4 pose of translation (3,) m and rotation matrix (3, 3)."""
    T = np.eye(4)
    T[:3, :3] = rotation
    T[:3, 3] = translation
    return T


def inverse(T: Array) -> Array:
    """The inverse of rigid motions (..., 4, 4), by transposing the rotation."""
    if T.ndim == 2:  # the same sums with fewer steps: asked several times a scan
        R_t, out = T[:3, :3].T, np.zeros((4, 4))
        out[:3, :3], out[:3, 3], out[3, 3] = R_t, -(R_t @ T[:3, 3]), 1.0
        return out
    R_t = np.swapaxes(T[..., :3, :3], -1, -2)
    out = np.zeros_like(T)
    out[..., :3, :3] = R_t
    out[..., :3, 3] = -(R_t @ T[..., :3, 3, None])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def transform(T: Array, points: Array) -> Array:
    """Points (N, 3) moved by T (4, 4)."""
    return points @ T[:3, :3].T + T[:3, 3]


def adjoint(T: Array) -> Array:
    """The (6, 6) matrix that moves a small motion through T: T exp(d) = exp(adjoint(T) d) T for
    d = (x, y, z, rx, ry, rz) in m and rad."""
    # plain floats, as in rigidity_error
    (a, b, c, x), (d, e, f, y), (g, h, i, z), _ = T.tolist()
    return np.array(
        [
            [a, b, c, y * g - z * d, y * h - z * e, y * i - z * f],
            [d, e, f, z * a - x * g, z * b - x * h, z * c - x * i],
            [g, h, i, x * d - y * a, x * e - y * b, x * f - y * c],
            [0.0, 0.0, 0.0, a, b, c],
            [0.0, 0.0, 0.0, d, e, f],
            [0.0, 0.0, 0.0, g, h, i],
        ]
    )


def symmetric(M: Array) -> Array:
    """Matrices (..., n, n) that are symmetric but for rounding, without that: a product such as
    A.T M A is symmetric to its last bit on some processors only."""
    return 0.5 * (M + np.swapaxes(M, -1, -2))


def translation_norm(T: Array) -> Array:
    """Length in m of the translation of motions (..., 4, 4)."""
    return np.linalg.norm(T[..., :3, 3], axis=-1)


def rotation_angle(T: Array) -> Array:
    """Absolute rotation angle in rad of motions (..., 4, 4), accurate near 0 and near pi."""
    R = T[..., :3, :3]
    sine = 0.5 * np.sqrt(
        (R[..., 2, 1] - R[..., 1, 2]) ** 2
        + (R[..., 0, 2] - R[..., 2, 0]) ** 2
        + (R[..., 1, 0] - R[..., 0, 1]) ** 2
    )
    cosine = 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0)
    return np.arctan2(sine, cosine)


def yaw(T: Array) -> Array:
    """Signed rotation about z in rad of motions (..., 4, 4)."""
    return np.arctan2(T[..., 1, 0], T[..., 0, 0])


def to_plane(T: Array) -> Array:
    """The planar motion nearest to T: x, y and yaw are kept, the rest is dropped."""
    return se2(T.item(3), T.item(7), float(np.arctan2(T.item(4), T.item(0))))


def to_rotation(R: Array) -> Array:
    """The rotation matrix nearest to R (3, 3) in the Frobenius norm (by SVD)."""
    U, _, Vt = np.linalg.svd(R)
    D = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    return U @ D @ Vt


def is_rigid(T: ArrayLike, tolerance: float = 1e-6) -> bool:
    """True for a finite 4x4 matrix with an orthonormal, right-handed rotation."""
    return rigidity_error(T) <= tolerance


def rigidity_error(T: ArrayLike) -> float:
    """How far a 4x4 matrix is from a rigid motion: the largest deviation of R R^T from I and of
    the last row from 0 0 0 1; infinite for another shape, NaN, infinity or a reflection."""
    M = np.asarray(T, dtype=float)
    if M.shape != (4, 4):
        return math.inf
    # plain floats: asked for every registration, and numpy's calls would cost more than the sums
    (a, b, c, x), (d, e, f, y), (g, h, i, z), (k, m, n, w) = M.tolist()
    off = max(
        abs(a * a + b * b + c * c - 1.0),
        abs(d * d + e * e + f * f - 1.0),
        abs(g * g + h * h + i * i - 1.0),
        abs(a * d + b * e + c * f),
        abs(a * g + b * h + c * i),
        abs(d * g + e * h + f * i),
        abs(k),
        abs(m),
        abs(n),
        abs(w - 1.0),
    )
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    # max() may pass over a NaN, sums and products do not
    sound = math.isfinite(determinant + x + y + z + k + m + n + w) and determinant > 0.0
    return off if sound else math.inf


def voxel_downsample(points: Array, voxel_size: float) -> Array:
    """The mean of the points (N, 3) in each cubic voxel of ``voxel_size`` m; 0 keeps every point.

    The order follows the voxels' first points, so the result is the same on every machine.
    """
    if voxel_size <= 0 or len(points) == 0:
        return points
    return _voxel_means(np.floor(points / voxel_size).astype(np.int64), points)


@kernel
def _voxel_means(cells: NDArray[np.int64], points: Array) -> Array:
    """The mean of the points (N, 3) with the same cell (N, 3), in the order of their first."""
    count, size = 0, 16
    while size < 2 * len(points):
        size *= 2
    table, first = np.full(size, -1), np.empty(len(points), np.int64)
    means, members = np.zeros((len(points), 3)), np.zeros(len(points))
    for i in range(len(points)):
        x, y, z = cells[i, 0], cells[i, 1], cells[i, 2]
        place = (x * 73856093 ^ y * 19349663 ^ z * 83492791) & (size - 1)  # Teschner et al. 2003
        while True:
            k = table[place]
            if k < 0:
                k = count
                table[place], first[k] = k, i
                count += 1
                break
            f = first[k]
            if cells[f, 0] == x and cells[f, 1] == y and cells[f, 2] == z:
                break
            place = (place + 1) & (size - 1)
        members[k] += 1.0
        for axis in range(3):
            means[k, axis] += points[i, axis]
    for k in range(count):
        for axis in range(3):
            means[k, axis] /= members[k]
    return means[:count].copy()
