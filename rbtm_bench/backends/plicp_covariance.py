"""How sure an ICP in the plane is of its result: Censi's covariance (2007) as information."""

from __future__ import annotations

import numpy as np

from rbtm_bench.backends.plicp_step import Matches
from rbtm_bench.core.geometry import symmetric
from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.types import Array

UNSEEN = 1e-6
"""A direction whose second derivative is this much smaller than the largest is not seen."""
NOISE_MARGIN = 2.0
"""Nor is one in which the normals vary less than so many times what the noise makes them vary."""
NO_RANGE = 1e-9
"""m: a point this near to the sensor has no beam."""
CERTAIN = 1e-12
"""No direction is this much more certain than the least certain one, whatever the noise does."""


def motion_information(
    source: Array, target: Array, matches: Matches, pose: Array, sigma: float
) -> Array:
    """The information (3, 3) of a small motion x, y (m), theta (rad) of the source in its frame.

    Points (N, 2), (M, 2) of scans whose sensors stand at the origin of their frames, and the
    ``pose`` (x, y, theta) of the source in the target. Censi (ICRA 2007): with J the sum of
    squared distances, x the motion and z all ranges of both scans, known to ``sigma`` m,

        cov(x) = (d2J/dx2)^-1 (d2J/dz dx) sigma^2 (d2J/dz dx)^T (d2J/dx2)^-1.

    J takes the distances to lines for both metrics: they have the same gradient wherever the foot
    lies within its segment. The inverse is taken among the motions that are seen; the others have
    information 0. Of a bare corridor the noise makes normals along the corridor too, which would
    count as sight: what it adds to d2J/dx2 is known, and has to be surpassed.
    """
    H, G, N = second_derivatives(source, target, matches, pose)
    lever = np.sqrt(2.0 * np.mean(source[matches.source] ** 2))
    scale = np.array([1.0, 1.0, max(lever, 1e-3)])  # m for rad: eigenvalues in one unit
    unit = 1.0 / np.outer(scale, scale)
    sight, V = np.linalg.eigh((H - NOISE_MARGIN * sigma**2 * N) * unit)
    U = V[:, sight > UNSEEN * sight[-1]]
    if not U.size:
        return np.zeros((3, 3))
    curvature = np.linalg.inv(U.T @ (H * unit) @ U)
    covariance = sigma**2 * curvature @ (U.T @ (G * unit) @ U) @ curvature
    spread, W = np.linalg.eigh(symmetric(covariance))
    spread = np.maximum(spread, CERTAIN * spread[-1])
    root = (U @ W) / np.sqrt(spread) * scale[:, None]
    return symmetric(root @ root.T)


@kernel
def second_derivatives(
    source: Array, target: Array, matches: Matches, pose: Array
) -> tuple[Array, Array, Array]:
    """Half of d2J/dx2, a quarter of (d2J/dz dx)(d2J/dz dx)^T, and what noise of 1 m in the ranges
    adds to the first by turning the normals; (3, 3) each. For a motion x of the source in its own
    frame, in which everything is computed, and residuals r = n.(R p + t - q) to lines through q.
    """
    c, s = np.cos(pose[2]), np.sin(pose[2])
    H, G, N = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    of_target = np.zeros((len(target), 3))
    of_source, a, turned = np.empty(3), np.empty(3), np.empty(3)
    for m in range(len(matches.source)):
        x, y = source[matches.source[m], 0], source[matches.source[m], 1]
        j, k = matches.first[m], matches.second[m]
        qx, qy = turn_back(target[j, 0] - pose[0], target[j, 1] - pose[1], c, s)
        ex, ey = turn_back(target[k, 0] - target[j, 0], target[k, 1] - target[j, 1], c, s)
        length = np.sqrt(ex * ex + ey * ey)
        ex, ey = ex / length, ey / length
        nx, ny = -ey, ex
        r = nx * (x - qx) + ny * (y - qy)
        share = (ex * (x - qx) + ey * (y - qy)) / length
        gradient(a, nx, ny, x, y)
        gradient(turned, ex, ey, x, y)
        add_outer(H, 1.0, a)
        H[2, 2] -= r * (nx * x + ny * y)
        # a longer range of p moves p
        distance = max(np.sqrt(x * x + y * y), NO_RANGE)
        bx, by = x / distance, y / distance
        of_source[:] = 0.0
        add(of_source, nx * bx + ny * by, a)
        of_source[2] += r * (ny * bx - nx * by)
        add_outer(G, 1.0, of_source)
        # one of q or of the other end moves the line and turns its normal, dn = -e (n.dq) / length
        n_j = beam_along(target, j, c, s, nx, ny)
        n_k = beam_along(target, k, c, s, nx, ny)
        add(of_target[j], (share - 1.0) * n_j, a)
        add(of_target[k], -share * n_k, a)
        add(of_target[j], r * n_j / length, turned)
        add(of_target[k], -r * n_k / length, turned)
        add_outer(N, (n_j * n_j + n_k * n_k) / (length * length), turned)
    for j in range(len(target)):
        add_outer(G, 1.0, of_target[j])
    return H, G, N


@kernel
def turn_back(x: float, y: float, c: float, s: float) -> tuple[float, float]:
    """A vector of the target frame in the source frame, which is turned by (cos, sin) = (c, s)."""
    return c * x + s * y, c * y - s * x


@kernel
def beam_along(target: Array, j: int, c: float, s: float, nx: float, ny: float) -> float:
    """How far along (nx, ny), of the source frame, target point ``j`` moves per m of its range."""
    bx, by = turn_back(target[j, 0], target[j, 1], c, s)
    return (bx * nx + by * ny) / max(np.sqrt(bx * bx + by * by), NO_RANGE)


@kernel
def gradient(a: Array, nx: float, ny: float, x: float, y: float) -> None:
    """``a`` = dr/dx of r = n.(R p + t - q) at no motion: (n, n.Jp), J a quarter turn."""
    a[0], a[1], a[2] = nx, ny, ny * x - nx * y


@kernel
def add(v: Array, factor: float, w: Array) -> None:
    """v += factor w for (3,), without an array in between."""
    for i in range(3):
        v[i] += factor * w[i]


@kernel
def add_outer(M: Array, factor: float, v: Array) -> None:
    """M += factor v v^T for (3, 3) and (3,)."""
    for i in range(3):
        for j in range(i + 1):
            M[i, j] += factor * v[i] * v[j]
            M[j, i] = M[i, j]
