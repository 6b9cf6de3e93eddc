"""Correlative scan matching in the plane: the best of all poses in a window, by branch and bound.

Olson, "Real-Time Correlative Scan Matching", ICRA 2009: the target is a table of likelihoods, a
pose's score the sum of those that the turned and shifted source points fall on. Hess, Kohler, Rapp
and Andor, "Real-Time Loop Closure in 2D LIDAR SLAM", ICRA 2016: maxima over blocks of the table
bound the scores of blocks of shifts, so that most poses are never scored, and none is missed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.backends.likelihood_field import BITS, FULL, Bytes, Field, with_widest
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.types import Array

Ints = NDArray[np.int64]
Sums = NDArray[np.uint16]

MOST_POINTS = 250
"""Source points that are looked at: the sum of so many bytes fits 16 bits."""
FINEST, COARSEST = math.radians(0.05), math.radians(2.0)
"""Limits of the step between two rotations."""
WIDE = 32
"""Shifts along an axis from which on the first bounds are those of the widest blocks."""
MOST_BLOCKS = 50_000_000
"""First bounds that a search may need."""

Place = tuple[int, int, int, int]
"""A pose of a window: its score, and the numbers of its rotation, row and column."""
Zone = tuple[int, int, int, int, int]
"""Poses left out: rotation, row and column of their middle; how far they reach in rotations and in
cells (-1: none are left out)."""


class Window(NamedTuple):
    """The poses that are looked at, around ``x``, ``y`` (m) and ``theta`` (rad): shifts of up to
    ``cells`` cells along each axis, and ``turns`` (K,) rad."""

    x: float
    y: float
    theta: float
    cells: int
    turns: Array

    @property
    def is_wide(self) -> bool:
        """Whether the first bounds are those of the field's widest blocks."""
        return 2 * self.cells + 1 > WIDE


class Peak(NamedTuple):
    """The best pose (x, y, theta) of a window, its ``score`` (the mean likelihood of the source
    points, 0 to 1), that of the middle of the window, and the score of the best pose apart from
    the best, as a share of its score."""

    pose: Array
    score: float
    middle_score: float
    peak_ratio: float


def thinned(points: Array, spacing: float) -> Array:
    """Of points (N, 2 or 3) m in order, those at least ``spacing`` m from the one kept before, as
    (M, 2); evenly fewer if more than ``MOST_POINTS`` are left."""
    places = spaced(points, spacing)
    if len(places) > MOST_POINTS:
        places = places[np.linspace(0, len(places) - 1, MOST_POINTS).round().astype(np.int64)]
    return np.ascontiguousarray(points[places, :2])


@kernel
def spaced(points: Array, spacing: float) -> Ints:
    """The places of the points that ``thinned`` keeps before it counts them."""
    places, count, x, y = np.empty(len(points), np.int64), 0, np.inf, np.inf
    for i in range(len(points)):
        if (points[i, 0] - x) ** 2 + (points[i, 1] - y) ** 2 >= spacing * spacing:
            x, y = points[i, 0], points[i, 1]
            places[count] = i
            count += 1
    return places[:count].copy()


def turns_of(points: Array, size: float, most: float) -> Array:
    """Rotations (K,) rad up to ``most`` either way, the middle one 0, all around from pi on. The
    step moves a point at the RMS range of ``points`` (N, 2) by one cell of ``size`` m."""
    lever = math.sqrt(float((points * points).sum() / len(points)))
    step = min(max(size / max(lever, size), FINEST), COARSEST)
    if most >= math.pi:
        count = math.ceil(2.0 * math.pi / step)
        return np.arange(-(count // 2), count - count // 2, dtype=np.float64) * (math.tau / count)
    count = max(math.ceil(most / step), 1)
    return np.arange(-count, count + 1, dtype=np.float64) * (most / count)


def search(points: Array, field: Field, window: Window, apart: float, apart_turn: float) -> Peak:
    """The pose of source points (M, 2) m, at most ``MOST_POINTS``, with the highest score in the
    window: what an exhaustive search would return. Of equal scores the one with the least turn,
    then the least shift, from the middle of the window, then the first in order.

    ``apart`` m or ``apart_turn`` rad from it lie the poses that its ``peak_ratio`` is about; NaN
    with an ``apart`` of 0. Raises ``BackendError`` for a window too large.
    """
    side = 2 * window.cells + 1
    top = 2 if window.is_wide else 1
    field = with_widest(field) if window.is_wide else field
    blocks = -(-side // (1 << BITS[top]))
    if len(window.turns) * blocks * blocks > MOST_BLOCKS:
        raise BackendError(
            f"correlative search over {side} x {side} shifts and {len(window.turns)} rotations: "
            "set a smaller window"
        )
    reach = math.ceil(apart / field.size)
    step = window.turns[1] - window.turns[0] if len(window.turns) > 1 else math.pi
    turn_reach = math.ceil(apart_turn / max(step, FINEST)) if reach else -1
    best, middle, second = best_two(points, field, window, top, blocks, turn_reach, reach)
    score, turn, row, column = best
    x = window.x + (column - window.cells) * field.size
    y = window.y + (row - window.cells) * field.size
    pose = np.array([x, y, window.theta + window.turns[turn]])
    ratio = max(second, 0) / score if reach and score > 0 else math.nan
    most = FULL * len(points)
    return Peak(pose, score / most, middle / most, ratio)


@kernel
def best_two(
    points: Array,
    field: Field,
    window: Window,
    top: int,
    blocks: int,
    turn_reach: int,
    reach: int,
) -> tuple[Place, int, int]:
    """The best pose, the score of the middle of the window, and that of the best pose outside the
    zone around the best (-1: none)."""
    left, low = places_of(points, field, window)
    bounds = first_bounds(field.levels[top], BITS[top], left, low, blocks)
    best = maximum(field, left, low, window, bounds, top, (0, 0, 0, -1, -1))
    middle, sums = len(window.turns) // 2, np.zeros((1, 1), np.uint16)
    for p in range(len(points)):
        row, column = low[middle, p] + window.cells, left[middle, p] + window.cells
        add_blocks(sums, field.levels[0], BITS[0], row, column)
    if turn_reach < 0:
        return best, int(sums[0, 0]), -1
    zone = (best[1], best[2], best[3], turn_reach, reach)
    second = maximum(field, left, low, window, bounds, top, zone)[0]
    return best, int(sums[0, 0]), second


@kernel
def places_of(points: Array, field: Field, window: Window) -> tuple[Ints, Ints]:
    """The column and row (K, N) of the cell that each point falls on under each rotation and the
    first shift."""
    left = np.empty((len(window.turns), len(points)), np.int64)
    low = np.empty((len(window.turns), len(points)), np.int64)
    for k in range(len(window.turns)):
        c, s = np.cos(window.theta + window.turns[k]), np.sin(window.theta + window.turns[k])
        for p in range(len(points)):
            x = c * points[p, 0] - s * points[p, 1] + window.x - field.corner[0]
            y = s * points[p, 0] + c * points[p, 1] + window.y - field.corner[1]
            left[k, p] = int(np.floor(x / field.size)) - window.cells
            low[k, p] = int(np.floor(y / field.size)) - window.cells
    return left, low


@kernel
def first_bounds(level: Bytes, bits: int, left: Ints, low: Ints, blocks: int) -> Sums:
    """Upper bounds (K, blocks, blocks) of the scores of all blocks of shifts."""
    bounds = np.zeros((len(left), blocks, blocks), np.uint16)
    for k in range(len(left)):
        sums = bounds[k]
        for p in range(left.shape[1]):
            add_blocks(sums, level, bits, low[k, p], left[k, p])
    return bounds


@kernel
def add_blocks(sums: Sums, level: Bytes, bits: int, row: int, column: int) -> None:
    """Add to ``sums`` (A, B) the level's values of A x B blocks side by side, the first of which
    begins at cell ``row``, ``column``; beyond the field they are 0."""
    mask = (1 << bits) - 1
    cells = level[row & mask, column & mask]
    row, column = row >> bits, column >> bits
    first, last = max(0, -column), min(sums.shape[1], cells.shape[1] - column)
    for j in range(max(0, -row), min(sums.shape[0], cells.shape[0] - row)):
        to, values = sums[j], cells[row + j]
        for i in range(first, last):
            to[i] += values[column + i]


@kernel
def maximum(
    field: Field, left: Ints, low: Ints, window: Window, bounds: Sums, top: int, zone: Zone
) -> Place:
    """The best pose outside a zone: blocks in the order of their bounds, as long as those are not
    below the best score so far."""
    flat = bounds.ravel()
    blocks, bits = bounds.shape[1], BITS[top]
    best = (-1, 0, 0, 0)
    stack = np.empty((40, 5), np.int64)
    first = np.array([np.argmax(flat)])  # a high score to begin with: fewer blocks to be sorted
    for attempt in range(2):
        if attempt == 1:
            first = np.flatnonzero(flat >= best[0])
            first = first[np.argsort(-flat[first].astype(np.int64), kind="mergesort")]
        for place in first:
            if flat[place] < best[0]:
                break
            rest = place % (blocks * blocks)
            stack[0, 0], stack[0, 1], stack[0, 2] = flat[place], top, place // (blocks * blocks)
            stack[0, 3], stack[0, 4] = (rest // blocks) << bits, (rest % blocks) << bits
            best = descend(field, left, low, window, stack, best, zone)
    return best


@kernel
def descend(
    field: Field, left: Ints, low: Ints, window: Window, stack: Ints, best: Place, zone: Zone
) -> Place:
    """The best pose after the block that lies on the ``stack`` (bound, level, rotation, row and
    column), depth first."""
    side, depth = 2 * window.cells + 1, 1
    sums = np.empty((4, 4), np.uint16)
    while depth > 0:
        depth -= 1
        bound, k, row, column = stack[depth, 0], stack[depth, 2], stack[depth, 3], stack[depth, 4]
        level = stack[depth, 1] - 1
        if not may_win(bound, k, row, column, 4 << BITS[level], window, best):
            continue
        sums[:] = 0
        for p in range(left.shape[1]):
            row_p, column_p = low[k, p] + row, left[k, p] + column
            add_blocks(sums, field.levels[level], BITS[level], row_p, column_p)
        start = depth
        for j in range(4):
            for i in range(4):
                y, x = row + (j << BITS[level]), column + (i << BITS[level])
                if y >= side or x >= side:
                    continue
                score = int(sums[j, i])
                if not may_win(score, k, y, x, 1 << BITS[level], window, best):
                    continue
                if level > 0:
                    depth = push(stack, start, depth, score, level, k, y, x)
                elif not is_inside(k, y, x, zone, len(window.turns)):
                    best = (score, k, y, x)
    return best


@kernel
def push(
    stack: Ints, start: int, depth: int, score: int, level: int, k: int, y: int, x: int
) -> int:
    """Put a block on the stack, from ``start`` on in the order of bounds, the highest last."""
    at = depth
    while at > start and stack[at - 1, 0] > score:
        stack[at] = stack[at - 1]
        at -= 1
    stack[at, 0], stack[at, 1], stack[at, 2], stack[at, 3], stack[at, 4] = score, level, k, y, x
    return depth + 1


@kernel
def may_win(
    score: int, k: int, row: int, column: int, width: int, window: Window, best: Place
) -> bool:
    """Whether a pose of a block with that bound, ``width`` shifts wide, may come before the best
    so far; for one alone, whether it does."""
    if score != best[0]:
        return score > best[0]
    middle, m = len(window.turns) // 2, window.cells
    y, x = min(max(m, row), row + width - 1) - m, min(max(m, column), column + width - 1) - m
    by, bx = best[2] - m, best[3] - m
    ours = (abs(k - middle), y * y + x * x)
    its = (abs(best[1] - middle), by * by + bx * bx)
    if ours != its or width > 1:
        return ours <= its
    return (k, row, column) < (best[1], best[2], best[3])


@kernel
def is_inside(k: int, row: int, column: int, zone: Zone, turns: int) -> bool:
    """Whether a pose is one of those that are left out; rotations go round."""
    away = abs(k - zone[0])
    away = min(away, turns - away) if turns > 1 else away
    return away <= zone[3] and abs(row - zone[1]) <= zone[4] and abs(column - zone[2]) <= zone[4]
