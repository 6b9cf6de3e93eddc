"""Hypotheses of Hough scan matching, compiled: peaks of the Hough domain, then held against the
points themselves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.backends.hough import (
    correlate_columns,
    correlate_spectra,
    directions,
    peaks,
    vote,
)
from rbtm_bench.backends.neighbours_2d import Sorted2D, nearest_2d, tangent_at
from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.types import Array

Pose = tuple[float, float, float]
"""x, y in m, theta in rad."""

TRANSLATIONS = 6
"""Translations, at most, that are tried with one rotation."""
APART_M, APART_RAD = 0.1, float(np.deg2rad(3.0))
"""Hypotheses that are nearer to each other than both are one."""
PARALLEL = 0.17
"""Sine of the angle (10 deg) below which two directions do not determine a translation."""
DAMPING = 0.01
"""Added to the normal matrix, as a share of the points: along a motion that hardly any of them
oppose (the axis of a corridor) the refinement hardly moves."""
SMALL_STEP = 1e-6
"""m and rad: the refinement has arrived."""


class HoughScan(NamedTuple):
    """``points`` (N, 2) m sorted for neighbours, and the surface's unit ``normals`` (N, 2).

    What votes: ``xy`` (M, 2) m about the ``middle`` (x, y) m of all points, at most ``reach`` m
    from it, with ``weights`` (M,) that sum to 1, and their ``spectrum`` (K,).
    """

    points: Sorted2D
    normals: Array
    xy: Array
    weights: Array
    middle: tuple[float, float]
    reach: float
    spectrum: Array


class Search(NamedTuple):
    """What the kernels need to know, in m, rad and bins."""

    cell: float
    hypotheses: int
    hypotheses_apart: float
    directions: int
    peaks: int
    peaks_apart: float
    max_rotation: float
    max_translation: float


@kernel
def surfaces(points: Sorted2D, radius: float) -> tuple[Array, Array]:
    """The surface's unit normal (N, 2) at each point, 0 0 where it is alone, and how
    many points lie within ``radius`` m (N,), itself included."""
    count = len(points.xy)
    normals, density = np.zeros((count, 2)), np.empty(count)
    for i in range(count):
        neighbours, tangent = tangent_at(points, i, radius)
        density[i] = neighbours
        if neighbours > 1:
            normals[i, 0], normals[i, 1] = -np.sin(tangent), np.cos(tangent)
    return normals, density


@kernel
def angle_between(a: float, b: float) -> float:
    """How far apart two angles are, rad."""
    return abs((a - b + np.pi) % (2.0 * np.pi) - np.pi)


@kernel
def hypotheses(target: HoughScan, source: HoughScan, search: Search, guess: Pose) -> Array:
    """Poses (H, 3) of the source in the target's frame (x, y in m, theta in rad), those with the
    most likely rotation first."""
    bins = len(target.spectrum)
    width = np.pi / bins
    allowed = np.ones(bins, dtype=np.bool_)
    for s in range(bins):
        off = angle_between(2.0 * s * width, 2.0 * guess[2]) / 2.0  # HS has a period of 180 deg
        allowed[s] = off <= search.max_rotation + width
    match = correlate_spectra(target.spectrum, source.spectrum)
    turns = peaks(match, True, allowed, search.hypotheses, search.hypotheses_apart)
    out = np.empty((2 * len(turns) * TRANSLATIONS, 3))
    count = 0
    reach = min(search.max_translation, target.reach + source.reach)
    # one buffer for all: fresh memory of this size costs more than the correlations
    heights = np.empty((search.directions, 2 * int(np.ceil(reach / search.cell)) + 1))
    for turn in turns:
        chosen = directions(
            target.spectrum, source.spectrum, int(np.round(turn)), search.directions
        )
        angles = chosen.astype(np.float64) * width
        for half in range(2):
            theta = turn * width + half * np.pi
            if angle_between(theta, guess[2]) > search.max_rotation:
                continue
            best = translations(target, source, search, theta, angles, guess, heights)
            out[count : count + len(best), :2] = best
            out[count : count + len(best), 2] = theta
            count += len(best)
    return out[:count]


@kernel
def translations(
    target: HoughScan,
    source: HoughScan,
    search: Search,
    theta: float,
    angles: Array,
    guess: Pose,
    heights: Array,
) -> Array:
    """The best translations (P, 2) m with rotation ``theta``, from the columns at ``angles``
    (D,) rad; ``heights`` (D, L) is overwritten with their correlations."""
    c, s = np.cos(theta), np.sin(theta)
    # between the scans' middles, which columns are counted from, a translation is larger by this
    mx = c * source.middle[0] - s * source.middle[1] - target.middle[0]
    my = s * source.middle[0] + c * source.middle[1] - target.middle[1]
    gx, gy = guess[0] + mx, guess[1] + my
    is_local = search.max_translation < target.reach + source.reach
    count, length = heights.shape
    lows = np.empty(count, dtype=np.int64)
    shifts = np.full((count, search.peaks), np.nan)
    allowed = np.ones(length, dtype=np.bool_)
    for d in range(count):
        of_target = vote(
            target.xy, target.weights, (1.0, 0.0), angles[d], search.cell, target.reach
        )
        of_source = vote(source.xy, source.weights, (c, s), angles[d], search.cell, source.reach)
        along = (gx * np.cos(angles[d]) + gy * np.sin(angles[d])) / search.cell
        lows[d] = (int(np.round(along)) if is_local else 0) - length // 2
        correlate_columns(of_target, of_source, lows[d], heights[d])
        highest = heights[d].max()
        if highest > 0.0:
            heights[d] /= highest
        places = peaks(heights[d], False, allowed, search.peaks, search.peaks_apart)
        shifts[d, : len(places)] = (places + lows[d]) * search.cell
    candidates = crossings(shifts, heights, lows, angles, search.cell)
    out = np.empty((TRANSLATIONS, 2))
    n = 0
    for i in range(len(candidates)):
        x, y = candidates[i, 0] - mx, candidates[i, 1] - my
        is_new = np.hypot(x - guess[0], y - guess[1]) <= search.max_translation
        for k in range(n):
            is_new = is_new and np.hypot(x - out[k, 0], y - out[k, 1]) > APART_M
        if is_new and n < TRANSLATIONS:
            out[n, 0], out[n, 1] = x, y
            n += 1
    return out[:n]


@kernel
def crossings(
    shifts: Array, heights: Array, lows: NDArray[np.int64], angles: Array, cell: float
) -> Array:
    """Translations (P, 2) m that two directions agree on: ``shifts`` (D, Q) m along ``angles``
    (D,), NaN after the last of each. The best first, by the sum over all directions of the
    correlations ``heights`` (D, L), which start at a shift of ``lows`` (D,) cells."""
    count, most = shifts.shape
    out = np.empty((count * (count - 1) // 2 * most * most, 2))
    score = np.empty(len(out))
    n = 0
    for i in range(count):
        for k in range(i + 1, count):
            across = np.sin(angles[k] - angles[i])
            if abs(across) < PARALLEL:
                continue
            for a in shifts[i]:
                for b in shifts[k]:
                    if np.isnan(a) or np.isnan(b):
                        continue
                    x = (a * np.sin(angles[k]) - b * np.sin(angles[i])) / across
                    y = (b * np.cos(angles[i]) - a * np.cos(angles[k])) / across
                    total = 0.0
                    for d in range(count):
                        along = (x * np.cos(angles[d]) + y * np.sin(angles[d])) / cell
                        place = int(np.round(along)) - lows[d]
                        if 1 <= place < heights.shape[1] - 1:
                            total += heights[d, place - 1 : place + 2].max()
                    out[n, 0], out[n, 1], score[n] = x, y, -total
                    n += 1
    return out[np.argsort(score[:n], kind="mergesort")]


@kernel
def likelihood(target: Sorted2D, xy: Array, pose: Pose, radius: float, stride: int) -> float:
    """The mean over every ``stride``-th of points (N, 2) of 1 - (d / radius)^2, d the distance
    (m) to the nearest target point; 0 from ``radius`` on."""
    x, y, theta = pose
    c, s = np.cos(theta), np.sin(theta)
    total, count = 0.0, 0
    for i in range(0, len(xy), stride):
        u, v = c * xy[i, 0] - s * xy[i, 1] + x, s * xy[i, 0] + c * xy[i, 1] + y
        place, distance = nearest_2d(target, u, v, radius)
        if place >= 0:
            total += 1.0 - (distance / radius) ** 2
        count += 1
    return total / count


@kernel
def likeliest(
    poses: Array, target: Sorted2D, xy: Array, radius: float, stride: int, most: int
) -> Array:
    """The likeliest of poses (H, 3), at most ``most`` different ones, the best first."""
    value = np.empty(len(poses))
    for i in range(len(poses)):
        pose = (poses[i, 0], poses[i, 1], poses[i, 2])
        value[i] = -likelihood(target, xy, pose, radius, stride)
    out = np.empty((most, 3))
    n = 0
    for i in np.argsort(value, kind="mergesort"):
        is_new = n < most
        for k in range(n):
            near = np.hypot(poses[i, 0] - out[k, 0], poses[i, 1] - out[k, 1]) < APART_M
            if near and angle_between(poses[i, 2], out[k, 2]) < APART_RAD:
                is_new = False
        if is_new:
            out[n] = poses[i]
            n += 1
    return out[:n]


@kernel
def normal_equations(
    target: HoughScan, xy: Array, pose: Pose, radius: float
) -> tuple[Array, Array, float, int]:
    """Of the distances e (m) from source points (N, 2) to the lines at their nearest target
    points within ``radius`` m: J^T J (3, 3), J^T e (3,), e^T e and their number, for a small
    motion x, y, rz of the source in its own frame."""
    x, y, theta = pose
    c, s = np.cos(theta), np.sin(theta)
    H, g = np.zeros((3, 3)), np.zeros(3)
    squares, count = 0.0, 0
    for i in range(len(xy)):
        px, py = xy[i, 0], xy[i, 1]
        u, v = c * px - s * py + x, s * px + c * py + y
        place, _ = nearest_2d(target.points, u, v, radius)
        if place < 0:
            continue
        nx, ny = target.normals[place, 0], target.normals[place, 1]
        if nx == 0.0 and ny == 0.0:
            continue
        e = nx * (target.points.xy[place, 0] - u) + ny * (target.points.xy[place, 1] - v)
        jx, jy = c * nx + s * ny, c * ny - s * nx
        jt = px * jy - py * jx
        H[0, 0] += jx * jx
        H[0, 1] += jx * jy
        H[0, 2] += jx * jt
        H[1, 1] += jy * jy
        H[1, 2] += jy * jt
        H[2, 2] += jt * jt
        g[0] += jx * e
        g[1] += jy * e
        g[2] += jt * e
        squares += e * e
        count += 1
    H[1, 0], H[2, 0], H[2, 1] = H[0, 1], H[0, 2], H[1, 2]
    return H, g, squares, count


@kernel
def refine(
    target: HoughScan, xy: Array, pose: Pose, radius: float, iterations: int
) -> tuple[Pose, int]:
    """The pose after least squares from points (N, 2) to lines, and the iterations taken."""
    x, y, theta = pose
    for iteration in range(iterations):
        H, g, _, count = normal_equations(target, xy, (x, y, theta), radius)
        if count < 3:
            return (x, y, theta), iteration
        damping = DAMPING * np.array([count, count, max(H[2, 2], 1e-6)])
        step = np.linalg.solve(H + np.diag(damping), g)
        c, s = np.cos(theta), np.sin(theta)
        x, y = x + c * step[0] - s * step[1], y + s * step[0] + c * step[1]
        theta += step[2]
        if np.abs(step).max() < SMALL_STEP:
            return (x, y, theta), iteration + 1
    return (x, y, theta), iterations
