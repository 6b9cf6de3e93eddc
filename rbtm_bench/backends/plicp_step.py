"""One step of ICP in the plane, in closed form: point to line (Censi 2008) and point to point."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.types import Array

FLAT = 1e-9
"""An eigenvalue this much smaller than the other counts as 0: nothing holds that direction."""
NEWTON_STEPS = 100
LONGEST_TURN = 0.5
"""rad, of a Newton step in the angle."""
SAME_TURN = 1e-9
"""Two turns whose cosines differ by less than twice this are equally far from none."""


class Matches(NamedTuple):
    """Correspondences (M,): a ``source`` point, the target points ``first`` (the nearest) and
    ``second`` (the one beside it) of its segment, and the ``distance`` (m) to that segment."""

    source: NDArray[np.int64]
    first: NDArray[np.int64]
    second: NDArray[np.int64]
    distance: Array


@kernel
def foot(x: float, y: float, target: Array, j: int, k: int) -> tuple[float, float]:
    """The point of the segment between points ``j`` and ``k`` of ``target`` nearest to (x, y)."""
    ex, ey = target[k, 0] - target[j, 0], target[k, 1] - target[j, 1]
    gx, gy = x - target[j, 0], y - target[j, 1]
    share = min(max((gx * ex + gy * ey) / (ex * ex + ey * ey), 0.0), 1.0)
    return target[j, 0] + share * ex, target[j, 1] + share * ey


@kernel
def step_to_points(moved: Array, target: Array, matches: Matches, count: int) -> Array:
    """The motion (x, y, theta) that brings the source points (N, 2), where they are now, closest to
    the nearest points of their segments, in the sum of squares."""
    feet = np.empty((count, 2))
    px = py = qx = qy = 0.0
    for m in range(count):
        x, y = moved[matches.source[m], 0], moved[matches.source[m], 1]
        feet[m, 0], feet[m, 1] = foot(x, y, target, matches.first[m], matches.second[m])
        px, py, qx, qy = px + x, py + y, qx + feet[m, 0], qy + feet[m, 1]
    px, py, qx, qy = px / count, py / count, qx / count, qy / count
    dot = cross = 0.0
    for m in range(count):
        ax, ay = moved[matches.source[m], 0] - px, moved[matches.source[m], 1] - py
        bx, by = feet[m, 0] - qx, feet[m, 1] - qy
        dot += ax * bx + ay * by
        cross += ax * by - ay * bx
    theta = np.arctan2(cross, dot)
    c, s = np.cos(theta), np.sin(theta)
    return np.array([qx - c * px + s * py, qy - s * px - c * py, theta])


@kernel
def step_to_lines(moved: Array, target: Array, matches: Matches, count: int) -> Array:
    """The motion (x, y, theta) that brings the source points (N, 2), where they are now, closest to
    the lines through their segments, in the sum of squares (Censi 2008).

    With y = (cos theta, sin theta) each residual n.(R p + t - q) is linear in t and y, so the sum
    is a quadratic form with the constraint |y| = 1. The best t for a given y is put in, which
    leaves two unknowns and Censi's Lagrange multiplier. What no line holds does not move. Two walls
    alone are met as well after another half turn: of two minima, a turn below 90 deg is preferred.
    """
    px = py = 0.0
    for m in range(count):
        px += moved[matches.source[m], 0]
        py += moved[matches.source[m], 1]
    px, py = px / count, py / count  # about the centroid, for the sake of precision
    tt = np.zeros(3)  # xx, xy, yy of the sums n n^T ...
    ty = np.zeros((2, 2))  # ... of n r^T with r = (n.p, n.Jp), J a quarter turn
    yy = np.zeros(3)
    gx = gy = hx = hy = 0.0
    for m in range(count):
        i, j, k = matches.source[m], matches.first[m], matches.second[m]
        ex, ey = target[k, 0] - target[j, 0], target[k, 1] - target[j, 1]
        length = np.sqrt(ex * ex + ey * ey)
        nx, ny = -ey / length, ex / length
        ax, ay = moved[i, 0] - px, moved[i, 1] - py
        rx, ry = nx * ax + ny * ay, ny * ax - nx * ay
        b = nx * (target[j, 0] - px) + ny * (target[j, 1] - py)
        tt[0], tt[1], tt[2] = tt[0] + nx * nx, tt[1] + nx * ny, tt[2] + ny * ny
        yy[0], yy[1], yy[2] = yy[0] + rx * rx, yy[1] + rx * ry, yy[2] + ry * ry
        ty[0, 0], ty[0, 1] = ty[0, 0] + nx * rx, ty[0, 1] + nx * ry
        ty[1, 0], ty[1, 1] = ty[1, 0] + ny * rx, ty[1, 1] + ny * ry
        gx, gy, hx, hy = gx + nx * b, gy + ny * b, hx + rx * b, hy + ry * b
    p0, p1, p2 = pseudo_inverse(tt[0], tt[1], tt[2])
    # K = P C for t = P g - K y
    k00, k01 = p0 * ty[0, 0] + p1 * ty[1, 0], p0 * ty[0, 1] + p1 * ty[1, 1]
    k10, k11 = p1 * ty[0, 0] + p2 * ty[1, 0], p1 * ty[0, 1] + p2 * ty[1, 1]
    S = (
        yy[0] - ty[0, 0] * k00 - ty[1, 0] * k10,
        yy[1] - ty[0, 0] * k01 - ty[1, 0] * k11,
        yy[2] - ty[0, 1] * k01 - ty[1, 1] * k11,
    )
    h = (hx - k00 * gx - k10 * gy, hy - k01 * gx - k11 * gy)
    c, s = on_the_circle(S, h)
    if c < 0.0:
        c, s = near_no_turn(S, h, c, s)
    x = p0 * gx + p1 * gy - k00 * c - k01 * s
    y = p1 * gx + p2 * gy - k10 * c - k11 * s
    return np.array([x + px - c * px + s * py, y + py - s * px - c * py, np.arctan2(s, c)])


@kernel
def eigen(a: float, b: float, c: float) -> tuple[float, float, float, float]:
    """The eigenvalues low <= high of [[a, b], [b, c]] and the unit eigenvector of the high one."""
    middle, half = 0.5 * (a + c), np.hypot(0.5 * (a - c), b)
    angle = 0.5 * np.arctan2(2.0 * b, a - c)
    return middle - half, middle + half, np.cos(angle), np.sin(angle)


@kernel
def pseudo_inverse(a: float, b: float, c: float) -> tuple[float, float, float]:
    """Of [[a, b], [b, c]], positive: its entries 00, 01, 11."""
    low, high, ux, uy = eigen(a, b, c)
    up = 1.0 / high if high > 0.0 else 0.0
    down = 1.0 / low if low > FLAT * high else 0.0
    return ux * ux * up + uy * uy * down, ux * uy * (up - down), uy * uy * up + ux * ux * down


@kernel
def on_the_circle(S: tuple[float, float, float], h: tuple[float, float]) -> tuple[float, float]:
    """The unit vector y with the least y.S y - 2 h.y; S by its entries 00, 01, 11.

    y = (S + lambda I)^-1 h with |y| = 1: Censi's quartic in lambda, whose largest root gives the
    minimum. In the eigenvectors of S it reads (g1 / (s1 + lambda))^2 + (g2 / (s2 + lambda))^2 = 1,
    falling and convex beyond -s1: Newton's method from below reaches that root and no other.
    Without g1 two minima are equal, of which the one nearer to (1, 0) is taken, and (1, 0)
    itself if they lie on either side of it.
    """
    low, high, ux, uy = eigen(S[0], S[1], S[2])
    g_high, g_low = ux * h[0] + uy * h[1], ux * h[1] - uy * h[0]
    if abs(g_low) <= 1e-14 * max(abs(high), abs(g_high)) and abs(g_high) <= high - low:
        r_high = g_high / (high - low) if high > low else 0.0
        r_low = -np.copysign(np.sqrt(1.0 - r_high * r_high), uy)
        if abs(uy * r_low) <= SAME_TURN:
            return 1.0, 0.0
        return ux * r_high - uy * r_low, uy * r_high + ux * r_low
    root = max(abs(g_low) - low, abs(g_high) - high)
    for _ in range(NEWTON_STEPS):
        r_low, r_high = g_low / (low + root), g_high / (high + root)
        above = r_low * r_low + r_high * r_high - 1.0
        slope = 2.0 * (r_low * r_low / (low + root) + r_high * r_high / (high + root))
        if not above > 1e-15:
            break
        root += above / slope
    r_low, r_high = g_low / (low + root), g_high / (high + root)
    y0, y1 = ux * r_high - uy * r_low, uy * r_high + ux * r_low
    length = np.hypot(y0, y1)
    return y0 / length, y1 / length


@kernel
def near_no_turn(
    S: tuple[float, float, float], h: tuple[float, float], c: float, s: float
) -> tuple[float, float]:
    """The other minimum of the same, by Newton's method in the angle from (1, 0), if it is a
    turn below 90 deg; else (c, s)."""
    angle = 0.0
    for _ in range(NEWTON_STEPS):
        x, y = np.cos(angle), np.sin(angle)
        Sx, Sy = S[0] * x + S[1] * y - h[0], S[1] * x + S[2] * y - h[1]
        slope = x * Sy - y * Sx
        bend = S[0] * y * y - 2.0 * S[1] * x * y + S[2] * x * x - x * Sx - y * Sy
        step = -slope / bend if bend > 0.0 else -np.copysign(LONGEST_TURN, slope)
        angle += min(max(step, -LONGEST_TURN), LONGEST_TURN)
        if abs(step) < 1e-15:
            break
    if bend > 0.0 and np.cos(angle) > 0.0 and abs(step) < 1e-9:
        return np.cos(angle), np.sin(angle)
    return c, s
