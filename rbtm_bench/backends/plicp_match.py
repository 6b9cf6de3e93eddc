"""The matches of an ICP of planar scans: points to segments of the target, then trimmed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.backends.neighbours_2d import Sorted2D, nearest_2d
from rbtm_bench.backends.plicp_step import Matches, foot
from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.types import Array

OTHER_WAY = 0.5
"""Cosine of 60 deg: two neighbours of a point lie on different sides of it if further apart."""
REACH = 3.0
"""The second neighbour may be this many times as far as the first: no lines across gaps."""
BAND = 0.1
"""m along the axis of sorting within which a search may have to look."""
TURNS = np.arange(12) * np.pi / 12
"""rad, the axes of sorting to choose from."""


class Surface(NamedTuple):
    """A scan as Censi's reference surface, in the sensor frame turned by ``turn`` rad.

    ``points`` in that frame, sorted by x; ``sides`` (N, 2) the places of each point's neighbour on
    either side, -1 for none: the segments of the surface. Needs no order of the points, so that it
    may be made of several scans.
    """

    points: Sorted2D
    sides: NDArray[np.int64]
    turn: float


class PlicpSettings(NamedTuple):
    """``PointToLineICP``'s parameters as its kernels take them."""

    distance: float
    to_line: bool
    max_iterations: int
    epsilon_xy: float
    epsilon_theta: float
    max_percent: float
    adaptive_order: float
    adaptive_multiplier: float
    refine_multiplier: float
    remove_doubles: bool
    min_share: float
    floor: float


def surface_of(points: Array, min_length: float) -> Surface:
    """The surface through points (N, 3) m with segments of at least ``min_length`` m."""
    turn = float(axis_of_sorting(points))
    ordered = sorted_turned(points, turn)
    return Surface(ordered, sides_of(ordered.xy, min_length), turn)


def joined_surface(points: Array, parts: Sequence[Surface], turn: float) -> Surface:
    """The surface through the points (N, 3) m of several, one after the other, turned by ``turn``
    rad: each keeps the segments that it had by itself."""
    ordered = sorted_turned(points, turn)
    place = np.empty(len(points) + 1, dtype=np.int64)
    place[ordered.original] = np.arange(len(points))
    place[-1] = -1
    sides, start = np.empty((len(points), 2), dtype=np.int64), 0
    for part in parts:
        own = np.append(part.points.original + start, len(points))  # where -1 leads to
        sides[own[:-1]] = own[part.sides]
        start += len(part.sides)
    return Surface(ordered, place[sides[ordered.original]], turn)


def sorted_turned(points: Array, turn: float) -> Sorted2D:
    """Points (N, 3) m turned by ``turn`` rad, sorted by x."""
    c, s = np.cos(turn), np.sin(turn)
    x, y = c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1]
    original = np.argsort(x, kind="stable").astype(np.int64)
    return Sorted2D(np.stack([x[original], y[original]], axis=1), original, 0)


@kernel
def axis_of_sorting(points: Array) -> float:
    """The turn (rad) of points (N, 3) after which the fewest pairs of them have nearly the same x.

    A wall along y would lie at one x, and every search near it would go through all its points.
    """
    fewest, best = np.inf, 0.0
    x = np.empty(len(points))
    for turn in TURNS:
        c, s = np.cos(turn), np.sin(turn)
        for i in range(len(points)):
            x[i] = c * points[i, 0] - s * points[i, 1]
        x.sort()
        pairs, low = 0, 0
        for i in range(len(x)):
            while x[i] - x[low] > BAND:
                low += 1
            pairs += i - low
        if pairs < fewest:
            fewest, best = pairs, turn
    return best


@kernel
def sides_of(xy: Array, min_length: float) -> NDArray[np.int64]:
    """For each point of ``xy`` (N, 2), sorted by x, the places (N, 2) of the nearest point at least
    ``min_length`` m away, and of the nearest such point in another direction, at most ``REACH``
    times as far; -1 for none."""
    sides = np.full((len(xy), 2), -1, dtype=np.int64)
    for j in range(len(xy)):
        first, length = neighbour(xy, j, min_length, np.inf, 0.0, 0.0)
        if first >= 0:
            ux, uy = (xy[first, 0] - xy[j, 0]) / length, (xy[first, 1] - xy[j, 1]) / length
            sides[j, 0] = first
            sides[j, 1], _ = neighbour(xy, j, min_length, REACH * length, ux, uy)
    return sides


@kernel
def neighbour(
    xy: Array, j: int, min_length: float, reach: float, ux: float, uy: float
) -> tuple[int, float]:
    """The place of the nearest point to point ``j`` that is at least ``min_length`` and less than
    ``reach`` m away, not at the same place and not in the direction (ux, uy); and its distance in
    m. -1 for none. ``xy`` is sorted by x."""
    least, nearest = reach * reach, -1
    for way in (1, -1):
        k = j + way
        while 0 <= k < len(xy) and (xy[k, 0] - xy[j, 0]) ** 2 < least:
            dx, dy = xy[k, 0] - xy[j, 0], xy[k, 1] - xy[j, 1]
            square = dx * dx + dy * dy
            is_in_reach = 0.0 < square < least and square >= min_length * min_length
            if is_in_reach and dx * ux + dy * uy <= OTHER_WAY * np.sqrt(square):
                least, nearest = square, k
            k += way
    return nearest, np.sqrt(least)


@kernel
def match(
    xy: Array,
    surface: Surface,
    pose: Array,
    settings: PlicpSettings,
    refines: bool,
    moved: Array,
    matches: Matches,
) -> tuple[int, float]:
    """Move the source points, match them to segments and trim: how many ``matches`` are left, and
    their mean square distance (m^2). ``moved`` (N, 2) becomes the points in the target frame.

    Of the two segments at the nearest target point the one with the nearer other end, or
    (point_to_point) the nearer segment: then its foot is the projection on the surface."""
    target = surface.points.xy
    c, s = np.cos(pose[2]), np.sin(pose[2])
    count = 0
    for i in range(len(xy)):
        x = c * xy[i, 0] - s * xy[i, 1] + pose[0]
        y = s * xy[i, 0] + c * xy[i, 1] + pose[1]
        moved[i, 0], moved[i, 1] = x, y
        j, _ = nearest_2d(surface.points, x, y, settings.distance)
        if j < 0 or surface.sides[j, 0] < 0:
            continue
        k, other = surface.sides[j, 0], surface.sides[j, 1]
        fx, fy = foot(x, y, target, j, k)
        if other >= 0:
            ox, oy = foot(x, y, target, j, other)
            if settings.to_line:
                nearer = squared(target, other, x, y) < squared(target, k, x, y)
            else:
                nearer = (x - ox) ** 2 + (y - oy) ** 2 < (x - fx) ** 2 + (y - fy) ** 2
            if nearer:
                k, fx, fy = other, ox, oy
        matches.source[count], matches.first[count], matches.second[count] = i, j, k
        matches.distance[count] = np.sqrt((x - fx) ** 2 + (y - fy) ** 2)
        count += 1
    if settings.remove_doubles:
        count = remove_doubles(moved, target, matches, count)
    order, floor = settings.adaptive_order, settings.floor
    if refines:
        return trim(matches, count, 1.0, order, settings.refine_multiplier, 0.0)
    return trim(matches, count, settings.max_percent, order, settings.adaptive_multiplier, floor)


@kernel
def squared(target: Array, j: int, x: float, y: float) -> float:
    """The squared distance (m^2) of target point ``j`` from (x, y)."""
    return (x - target[j, 0]) ** 2 + (y - target[j, 1]) ** 2


@kernel
def remove_doubles(moved: Array, target: Array, matches: Matches, count: int) -> int:
    """Keep, of the source points with the same nearest target point, the nearest to it; the first
    of several equally near. Returns how many of the first ``count`` matches are left."""
    nearest = np.full(len(target), np.inf)
    owner = np.full(len(target), -1)
    for m in range(count):
        i, j = matches.source[m], matches.first[m]
        square = squared(target, j, moved[i, 0], moved[i, 1])
        if square < nearest[j]:
            nearest[j], owner[j] = square, i
    kept = 0
    for m in range(count):
        if owner[matches.first[m]] == matches.source[m]:
            move(matches, m, kept)
            kept += 1
    return kept


@kernel
def trim(
    matches: Matches, count: int, percent: float, order: float, multiplier: float, floor: float
) -> tuple[int, float]:
    """Drop the matches farther than ``floor`` m that are farther than the one at the share
    ``percent`` of them, or than ``multiplier`` times the one at the share ``order``: how many are
    left, and their mean square distance (m^2)."""
    if count == 0:
        return 0, 0.0
    distance = matches.distance[:count]
    place = min(int(count * order), count - 1)
    limit = multiplier * np.partition(distance, place)[place]
    place = int(count * percent)
    if place < count:
        limit = min(limit, np.partition(distance, place)[place])
    limit = max(limit, floor)
    kept, total = 0, 0.0
    for m in range(count):
        if matches.distance[m] <= limit:
            total += matches.distance[m] ** 2
            move(matches, m, kept)
            kept += 1
    return kept, total / max(kept, 1)


@kernel
def move(matches: Matches, start: int, end: int) -> None:
    """Write match ``start`` to place ``end``."""
    matches.source[end] = matches.source[start]
    matches.first[end] = matches.first[start]
    matches.second[end] = matches.second[start]
    matches.distance[end] = matches.distance[start]


@kernel
def shortened(matches: Matches, count: int) -> Matches:
    """A copy of the first ``count`` matches."""
    return Matches(
        matches.source[:count].copy(),
        matches.first[:count].copy(),
        matches.second[:count].copy(),
        matches.distance[:count].copy(),
    )
