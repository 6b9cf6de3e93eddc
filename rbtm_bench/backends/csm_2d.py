"""Correlative scan matching (Olson 2009), by branch and bound: a backend of its own."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le

from rbtm_bench.backends.base import Alignment, Backend, Prepared
from rbtm_bench.backends.correlative import CorrelativeMatcher
from rbtm_bench.backends.correlative_search import turns_of
from rbtm_bench.backends.likelihood_field import FULL, Field
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import se2, symmetric
from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.kinds import Distance, VoxelSize
from rbtm_bench.core.types import Array

Positive = Annotated[float, Gt(0)]

PLANAR = [0, 1, 5]
"""x, y, rz among the six of ``Alignment.information``."""
SCALES = (1.0, 0.5)
"""Spacing of the poses that the surface is fitted to, in steps of the search, one after another."""
FLAT = 0.01
"""A direction that the score falls along by less than this part of the steepest is not seen."""


class CorrelativeScanMatching(Backend):
    """Olson, "Real-Time Correlative Scan Matching", ICRA 2009, with the bounds of Hess, Kohler,
    Rapp and Andor, "Real-Time Loop Closure in 2D LIDAR SLAM", ICRA 2016; our own code.

    Of all poses up to ``max_translation`` m along x and y and ``max_rotation_deg`` from the guess
    (null: everywhere in the target's bounding box; all around) the one with the highest score: the
    mean over source points of exp(-d^2 / (2 ``sigma``^2)), d m to the nearest target point, read
    from a table with cells of ``cell_size`` m. Shifts are a cell apart, rotations so much that a
    point at the RMS range moves by a cell. The maximum is exact: what an exhaustive search finds.

    Between the cells, a quadratic surface through the scores of the 27 poses around the best one,
    twice, the second time half as far apart, gives the pose; what it does not fall along keeps the
    best cell. Its curvature is the information: that of points at the distance ``sigma`` from the
    walls by chance, so it is careful where ranges are better than that. (Olson takes the moments of
    the scores instead, which cells as wide as the peak would blur.)

    ``converged``: a score of at least ``min_score``. ``library_fitness`` is the score. The guess
    decides nothing but where the window lies and which of equal scores is taken.
    ``max_correspondence_distance`` is the evaluator's radius only. Deterministic.
    """

    library = "our own (MIT)"
    converged_means = "score of at least `min_score`"
    repeats = "same bits; one thread"
    dimensions = ("2d",)
    self_tolerance = 0.01  # points are compared with cells

    def __init__(
        self,
        max_correspondence_distance: Distance = 0.3,
        voxel_size: VoxelSize = 0.0,
        max_translation: Positive | None = 1.0,
        max_rotation_deg: Annotated[float, Gt(0), Le(180)] | None = 45.0,
        cell_size: Positive = 0.05,
        sigma: Positive = 0.1,
        min_score: Annotated[float, Ge(0), Le(1)] = 0.3,
    ) -> None:
        super().__init__(max_correspondence_distance, voxel_size)
        self.uses_guess = max_translation is not None or max_rotation_deg is not None
        self.max_translation = max_translation
        self.max_rotation = math.pi if max_rotation_deg is None else math.radians(max_rotation_deg)
        self.min_score = min_score
        self.matcher = CorrelativeMatcher(cell_size, sigma)
        corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)
        square = Prepared(corners, True, None)
        fitted(corners[:, :2].copy(), self.matcher.field(square), np.zeros(3), 0.1)  # compiles

    def build(self, points: Array, planar: bool) -> None:
        if not planar:
            raise BackendError("csm_2d registers planar scans only")

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        peak = self.matcher.match(
            source, target, T_target_source, self.max_translation, self.max_rotation
        )
        if peak.score == 0.0:
            return Alignment(T_target_source, converged=False, library_fitness=0.0)
        points, field = self.matcher.points(source), self.matcher.field(target)
        turns = turns_of(points, field.size, math.pi)
        pose, information = fitted(points, field, peak.pose, float(turns[1] - turns[0]))
        return Alignment(
            se2(*pose),
            converged=bool(peak.score >= self.min_score),
            information=information,
            library_fitness=peak.score,
        )


def fitted(points: Array, field: Field, pose: Array, turn: float) -> tuple[Array, Array]:
    """The pose (x, y, theta) between the cells, and its information (6, 6).

    The least squares fit of s(d) = s0 + g.d - d.H d / 2 to the scores at steps d = -1, 0, 1 along
    each axis, in closed form; the pose moves by H^-1 g, at most a step along each axis, among the
    directions that H sees.
    """
    for scale in SCALES:
        steps = scale * np.array([field.size, field.size, turn])
        s = surface(points, field, pose, steps[0], steps[2])
        d = np.array([-1.0, 0.0, 1.0])
        x, y, t = d[:, None, None], d[None, :, None], d[None, None, :]
        g = np.array([(s * x).sum(), (s * y).sum(), (s * t).sum()]) / 18.0
        third = 2.0 / 3.0
        bends = [(s * (one * one - third)).sum() / 3.0 for one in (x, y, t)]
        xy, xt, yt = (s * x * y).sum() / 12.0, (s * x * t).sum() / 12.0, (s * y * t).sum() / 12.0
        H = -np.array([[bends[0], xy, xt], [xy, bends[1], yt], [xt, yt, bends[2]]])
        falls, V = np.linalg.eigh(H)
        sees = falls > FLAT * max(falls[-1], 1e-9)
        V, falls = V[:, sees], falls[sees]
        pose = pose + steps * np.clip(V @ ((V.T @ g) / falls), -1.0, 1.0)
    root = np.sqrt(falls) * V / steps[:, None]
    R = se2(0.0, 0.0, pose[2])[:3, :3]  # x and y into the source's frame
    information = np.zeros((6, 6))
    information[np.ix_(PLANAR, PLANAR)] = symmetric(R.T @ (root @ root.T) @ R)
    return pose, information


@kernel
def surface(points: Array, field: Field, pose: Array, step: float, turn: float) -> Array:
    """The sums of likelihoods (3, 3, 3) of the poses one step before, at and after ``pose`` along
    x, y and theta: between the middles of cells in proportion."""
    cells = field.levels[0][0, 0]
    height, width = cells.shape
    out = np.zeros((3, 3, 3))
    for k in range(3):
        c, s = np.cos(pose[2] + (k - 1) * turn), np.sin(pose[2] + (k - 1) * turn)
        for p in range(len(points)):
            px, py = c * points[p, 0] - s * points[p, 1], s * points[p, 0] + c * points[p, 1]
            for i in range(3):
                x = (px + pose[0] + (i - 1) * step - field.corner[0]) / field.size - 0.5
                left = int(np.floor(x))
                if left < 0 or left + 1 >= width:
                    continue
                for j in range(3):
                    y = (py + pose[1] + (j - 1) * step - field.corner[1]) / field.size - 0.5
                    low = int(np.floor(y))
                    if low < 0 or low + 1 >= height:
                        continue
                    u, v = x - left, y - low
                    lower = (1.0 - u) * cells[low, left] + u * cells[low, left + 1]
                    upper = (1.0 - u) * cells[low + 1, left] + u * cells[low + 1, left + 1]
                    out[i, j, k] += ((1.0 - v) * lower + v * upper) / FULL
    return out
