"""Hough scan matching (Censi, Iocchi and Grisetti 2005): our own code, from the paper."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le

from rbtm_bench.backends.base import MIN_POINTS, Alignment, Backend, Prepared
from rbtm_bench.backends.hough import hough_spectrum
from rbtm_bench.backends.hough_search import (
    HoughScan,
    Pose,
    Search,
    angle_between,
    hypotheses,
    likeliest,
    likelihood,
    normal_equations,
    refine,
    surfaces,
)
from rbtm_bench.backends.neighbours_2d import sorted_2d
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import se2, yaw
from rbtm_bench.core.kinds import Distance, VoxelSize
from rbtm_bench.core.types import Array

Positive = Annotated[float, Gt(0)]

REFINED = 6
"""Hypotheses that are refined."""
SCREENING_POINTS = 90
"""Source points, at least, that hypotheses are compared with before the best are refined."""
WIDER = 2.0
"""Hough estimates are off by a cell or two: until refined they are given that many times
``likelihood_radius``."""
FIRST_ITERATIONS = 5
"""Of the refinement, for every hypothesis; the rest is for the one that is chosen."""
SAME = 0.3
"""m, see ``distance``: poses nearer than this are one answer, not two."""
SMALLEST_DEVIATION = 1e-3
"""m, of points from lines: identical scans would give infinite information."""


class HoughScanMatching(Backend):
    """Global matching in the Hough domain, by our own code after A. Censi, L. Iocchi and G.
    Grisetti, "Scan matching in the Hough domain" (ICRA 2005). It looks at every rotation and
    translation, whatever the guess. Deterministic; one thread.

    1. Every point votes for the lines through it: HT(theta, rho). The Hough spectrum
       HS(theta) = sum over rho of HT^2 does not change under translation and turns with the scan.
    2. Peaks of the circular cross-correlation of both spectra are the rotation's hypotheses, each
       a second time turned by 180 deg, as HS has that period.
    3. For each, the columns of HT in a few directions where both spectra are high are
       cross-correlated; a peak at d says u . t = d for the translation t along the direction u.
       Two directions give t; how high all correlations are at t ranks the translations.
    4. The hypotheses are ranked by likelihood: the mean over source points of 1 - (d / radius)^2,
       d the distance to the nearest target point, 0 from ``likelihood_radius`` m on.

    Not in the paper: (a) with ``votes`` surface a point's vote is divided by the number of its
    neighbours within ``normal_radius`` m, so that surfaces count by their length and not by how
    near they were seen (points: a vote each, as in the paper); (b) the 6 likeliest hypotheses are
    refined by least squares from points to lines (through the nearest target point, across the
    least spread of its neighbours within ``normal_radius``), within twice ``likelihood_radius``,
    the chosen one for up to ``refine_iterations``. With 0 the result is what the cells give, a few
    mm and tenths of a degree off, for a scan registered to itself, too.

    Other parameters, with the names of Censi's csm: ``linear_cell_size`` (m) and
    ``angular_cell_size_deg`` of HT; ``num_angular_hypotheses``, at least
    ``angular_hyp_min_distance_deg`` apart; ``xc_ndirections`` per rotation;
    ``linear_xc_max_npeaks`` per direction, at least ``linear_xc_peaks_min_distance`` m apart;
    ``max_norm`` m, points farther from the scan's middle do not vote (None: all do).
    ``max_rotation_deg`` and ``max_translation`` (m) limit the search to that much around the
    guess, the paper's local variant (None: everywhere). ``max_correspondence_distance`` is the
    evaluator's only.

    Of different hypotheses that are less likely than the best by at most ``ambiguity`` (in a
    rectangular room the right one and that turned by 180 deg), the one nearest to the guess is
    taken; the guess decides nothing else. ``converged`` is False if the result is less likely than
    ``min_likelihood``; without any hypothesis the guess comes back so. The library's fitness is
    the likelihood, its RMSE the points' distance from the lines; the information is the
    refinement's normal matrix over their variance (at least 1 mm squared).
    """

    library = "our own (MIT)"
    converged_means = "likelihood of at least `min_likelihood`"
    repeats = "same bits; one thread"
    dimensions = ("2d",)
    uses_guess = False

    def __init__(
        self,
        max_correspondence_distance: Distance = 0.3,
        voxel_size: VoxelSize = 0.0,
        linear_cell_size: Positive = 0.03,
        angular_cell_size_deg: Annotated[float, Gt(0), Le(10)] = 1.0,
        num_angular_hypotheses: Annotated[int, Ge(1)] = 8,
        angular_hyp_min_distance_deg: Annotated[float, Ge(0)] = 10.0,
        xc_ndirections: Annotated[int, Ge(2)] = 3,
        linear_xc_max_npeaks: Annotated[int, Ge(1)] = 5,
        linear_xc_peaks_min_distance: Annotated[float, Ge(0)] = 0.15,
        max_norm: Positive | None = None,
        votes: Literal["surface", "points"] = "surface",
        normal_radius: Distance = 0.3,
        max_rotation_deg: Positive | None = None,
        max_translation: Positive | None = None,
        likelihood_radius: Positive = 0.1,
        min_likelihood: Annotated[float, Ge(0), Le(1)] = 0.45,
        ambiguity: Annotated[float, Ge(0), Le(1)] = 0.05,
        refine_iterations: Annotated[int, Ge(0)] = 20,
    ) -> None:
        super().__init__(max_correspondence_distance, voxel_size)
        self.bins = round(180.0 / angular_cell_size_deg)
        self.max_norm = np.inf if max_norm is None else max_norm
        self.votes = votes
        self.normal_radius = float(normal_radius)
        self.likelihood_radius = float(likelihood_radius)
        self.min_likelihood = min_likelihood
        self.ambiguity = ambiguity
        self.refine_iterations = refine_iterations
        if refine_iterations == 0:
            self.self_tolerance = 0.02
        is_local = max_rotation_deg is not None or max_translation is not None
        self.uses_guess = is_local
        self.search = Search(
            cell=float(linear_cell_size),
            hypotheses=num_angular_hypotheses,
            hypotheses_apart=angular_hyp_min_distance_deg * self.bins / 180.0,
            directions=xc_ndirections,
            peaks=linear_xc_max_npeaks,
            peaks_apart=linear_xc_peaks_min_distance / linear_cell_size,
            max_rotation=np.inf if max_rotation_deg is None else np.deg2rad(max_rotation_deg),
            max_translation=np.inf if max_translation is None else float(max_translation),
        )
        _compile(self)

    def build(self, points: Array, planar: bool) -> HoughScan:
        if not planar:
            raise BackendError("Hough scan matching is for planar scans")
        placed = sorted_2d(points)
        normals, density = surfaces(placed, self.normal_radius)
        mean = placed.xy.mean(axis=0)
        xy = placed.xy - mean
        norm = np.hypot(xy[:, 0], xy[:, 1])
        votes = norm <= self.max_norm
        if votes.sum() < MIN_POINTS:
            raise BackendError(f"{votes.sum()} points within max_norm: expected {MIN_POINTS}")
        weights = 1.0 / density[votes] if self.votes == "surface" else np.ones(votes.sum())
        weights /= weights.sum()
        xy, reach, middle = xy[votes], float(norm[votes].max()), (float(mean[0]), float(mean[1]))
        spectrum = hough_spectrum(xy, weights, reach, self.search.cell, self.bins)
        return HoughScan(placed, normals, xy, weights, middle, reach, spectrum)

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        guess = (T_target_source[0, 3], T_target_source[1, 3], float(yaw(T_target_source)))
        scan: HoughScan = source.native
        model: HoughScan = target.native
        xy, radius = scan.points.xy, self.likelihood_radius
        within = WIDER * radius
        stride = max(1, len(xy) // SCREENING_POINTS)
        starts = hypotheses(model, scan, self.search, guess)
        starts = likeliest(starts, model.points, xy, within, stride, REFINED)
        few = min(FIRST_ITERATIONS, self.refine_iterations)
        some = np.ascontiguousarray(xy[::stride])  # to tell them apart that will do
        first = [refine(model, some, tuple(p), within, few) for p in starts]
        first = [(pose, n) for pose, n in first if self._is_within_limits(pose, guess)]
        if not first:
            return Alignment(T_target_source, False, 0)
        poses = [pose for pose, _ in first]
        likely = [likelihood(model.points, xy, pose, radius, 1) for pose in poses]
        i = self._chosen(scan, poses, likely, guess)
        pose, iterations = refine(model, xy, poses[i], within, self.refine_iterations - few)
        if not self._is_within_limits(pose, guess):
            pose = poses[i]
        iterations += first[i][1]
        likely[i] = likelihood(model.points, xy, pose, radius, 1)
        H, _, squares, count = normal_equations(model, xy, pose, within)
        deviation = float(np.sqrt(squares / max(count, 1)))
        information = np.zeros((6, 6))
        information[np.ix_((0, 1, 5), (0, 1, 5))] = H / max(deviation, SMALLEST_DEVIATION) ** 2
        converged = likely[i] >= self.min_likelihood
        return Alignment(se2(*pose), converged, iterations, information, likely[i], deviation)

    def _is_within_limits(self, pose: Pose, guess: Pose) -> bool:
        """False where the refinement left the part of the search space that was asked for."""
        shift = math.hypot(pose[0] - guess[0], pose[1] - guess[1])
        turn = angle_between(pose[2], guess[2])
        return shift <= self.search.max_translation and turn <= self.search.max_rotation

    def _chosen(self, scan: HoughScan, poses: list[Pose], likely: list[float], guess: Pose) -> int:
        """The likeliest pose; of equally likely ones that are not the same, the one nearest to
        the guess."""
        order = sorted(range(len(poses)), key=lambda i: -likely[i])
        ties = [order[0]]
        for i in order[1:]:
            is_new = min(distance(scan, poses[i], poses[k]) for k in ties) > SAME
            if likely[i] >= likely[order[0]] - self.ambiguity and is_new:
                ties.append(i)
        return min(ties, key=lambda i: distance(scan, poses[i], guess))


def distance(scan: HoughScan, a: Pose, b: Pose) -> float:
    """How far apart (m) two poses put the middle of a scan, plus how far a point at its edge is
    turned."""
    u, v = scan.middle
    (ax, ay), (bx, by) = (
        (x + math.cos(t) * u - math.sin(t) * v, y + math.sin(t) * u + math.cos(t) * v)
        for x, y, t in (a, b)
    )
    return math.hypot(ax - bx, ay - by) + scan.reach * angle_between(a[2], b[2])


def _compile(method: HoughScanMatching) -> None:
    """Register a small scan once, so that no registration is charged for compiling."""
    along = np.linspace(0.0, 1.0, 20)
    points = np.concatenate(
        [np.column_stack([along, 0 * along]), np.column_stack([0 * along, 0.7 * along])]
    )
    model = method._prepared(np.column_stack([points, np.zeros(40)]), True, ((0, None),))
    method.align(model, model, np.eye(4))
