"""The simulated places: walls as ground segments, and the path the robot drives. All in metres.

The frame of every place: the path starts at x = 0, y = 0 and heads along +x.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rbtm_bench.core.geometry import se2
from rbtm_bench.core.types import Array

Point = tuple[float, float]
Segment = tuple[Point, Point]


@dataclass(frozen=True)
class Environment:
    """Walls, and a path of pieces (length m, curvature 1/m) that starts at the origin along +x.

    ``default_length`` (m) is how much of the path is driven unless the user says otherwise.
    """

    walls: tuple[Segment, ...]
    path: tuple[tuple[float, float], ...]
    default_length: float

    @property
    def path_length(self) -> float:
        """The longest drive that stays clear of the walls, m."""
        return sum(length for length, _ in self.path)

    def poses(self, distances: Array) -> Array:
        """T_world_sensor (S, 4, 4) after ``distances`` (S,) m along the path."""
        return np.stack([self._pose(float(distance)) for distance in distances])

    def _pose(self, distance: float) -> Array:
        T = np.eye(4)
        for length, curvature in self.path:
            T = T @ arc(min(distance, length), curvature)
            distance -= length
            if distance <= 0.0:
                break
        return T


def arc(length: float, curvature: float) -> Array:
    """The motion (4, 4) along ``length`` m of a circle of ``curvature`` (1/m, > 0 to the left)."""
    turn = length * curvature
    if turn == 0.0:
        return se2(length, 0.0, 0.0)
    return se2(np.sin(turn) / curvature, (1.0 - np.cos(turn)) / curvature, turn)


def polyline(*points: Point, closed: bool = False) -> tuple[Segment, ...]:
    """The segments from point to point."""
    ends = points[1:] + points[:1] if closed else points[1:]
    return tuple(zip(points, ends, strict=False))


def box(x0: float, y0: float, x1: float, y1: float) -> tuple[Segment, ...]:
    """The outline of a rectangle."""
    return polyline((x0, y0), (x1, y0), (x1, y1), (x0, y1), closed=True)


def wall_with_recesses(
    y: float, outward: int, x0: float, x1: float, recesses: Sequence[tuple[float, float, float]]
) -> tuple[Segment, ...]:
    """A wall along x at ``y`` from ``x0`` to ``x1`` with rectangular recesses.

    A recess is (start x, end x, depth); ``outward`` is +1 or -1, the side of y it reaches to.
    """
    points = [(x0, y)]
    for start, end, depth in recesses:
        back = y + outward * depth
        points += [(start, y), (start, back), (end, back), (end, y)]
    return polyline(*points, (x1, y))


# After Fig. 3 of the paper: a walled corridor with recesses (o: start, >: end of 1.8 m).
#
#      y      ___         ___           ____
#   +1 _|____|   |_______|   |_________|    |________________
#       |          o - - - - - >                             |
#   -1 _|_________      _________    ____________     _______|
#                 |____|         |__|            |___|
#       -1.5       0.2            1.8             3.6        5.0  x
PAPER = Environment(
    walls=(
        *wall_with_recesses(
            +1.0, +1, -1.5, 5.0, [(-0.6, 0.0, 0.3), (1.0, 1.6, 0.3), (2.6, 3.2, 0.4)]
        ),
        *wall_with_recesses(
            -1.0, -1, -1.5, 5.0, [(0.2, 0.8, 0.3), (1.8, 2.4, 0.3), (3.6, 4.1, 0.5)]
        ),
        *polyline((-1.5, -1.0), (-1.5, 1.0)),
        *polyline((5.0, -1.0), (5.0, 1.0)),
    ),
    path=((4.0, 0.0),),
    default_length=1.8,
)

# Two walls and nothing else: the end walls stay 6 m away, so a 4 m laser cannot tell where along
# the corridor it is. No method can be right in it; a good one says so.
#
#   +1 ______________________________
#      o - - - - - - - - - - ->
#   -1 ______________________________
BARE = Environment(
    walls=box(-6.0, -1.0, 26.0, 1.0),
    path=((20.0, 0.0),),
    default_length=20.0,
)

# A room of 8 m x 6 m with boxes on both sides of the way.
#
#   +3 ________________________________
#     |    [  ]            [____]   [] |
#     |             []                 |
#     |  o - - - - - - - - - - - - ->  |
#     |    []           [   ]          |
#     |          [__]            [  ]  |
#   -3 ________________________________
#     -1                               7  x
CLUTTERED = Environment(
    walls=(
        *box(-1.0, -3.0, 7.0, 3.0),
        *box(0.2, 1.9, 1.0, 2.5),
        *box(2.1, 0.9, 2.5, 1.3),
        *box(3.9, 1.8, 5.3, 2.3),
        *box(6.1, 1.6, 6.5, 2.1),
        *box(0.1, -1.3, 0.5, -0.8),
        *box(1.5, -2.6, 2.4, -2.0),
        *box(3.2, -1.6, 4.1, -0.9),
        *box(5.4, -2.4, 6.2, -1.7),
    ),
    path=((6.0, 0.0),),
    default_length=6.0,
)

# A corridor that turns left by 90 degrees on a radius of 1 m around its inner corner.
#
#   +6             ___
#                 | ^ |
#                 | | |_
#   +1 ___________| |  _|
#     |   o - - - - '  |
#   -1 ____      ______|
#          |____|
#     -2          3    5  x
L_TURN = Environment(
    walls=(
        *wall_with_recesses(-1.0, -1, -2.0, 5.0, [(1.0, 1.8, 0.4)]),
        *polyline((5.0, -1.0), (5.0, 2.0), (5.4, 2.0), (5.4, 2.8), (5.0, 2.8), (5.0, 6.0)),
        *polyline((5.0, 6.0), (3.0, 6.0), (3.0, 1.0), (-2.0, 1.0), (-2.0, -1.0)),
    ),
    path=((3.0, 0.0), (0.5 * np.pi, 1.0), (3.0, 0.0)),
    default_length=6.0 + 0.5 * np.pi,
)

ENVIRONMENTS = {"paper": PAPER, "bare": BARE, "cluttered": CLUTTERED, "l_turn": L_TURN}
