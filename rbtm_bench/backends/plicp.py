"""Point-to-line ICP with trimming (Censi 2008), and its point-to-point form: our own kernels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le

from rbtm_bench.backends.base import Alignment, Backend, Prepared, joined_key
from rbtm_bench.backends.plicp_covariance import motion_information
from rbtm_bench.backends.plicp_match import (
    PlicpSettings,
    Surface,
    joined_surface,
    match,
    shortened,
    surface_of,
)
from rbtm_bench.backends.plicp_step import Matches, step_to_lines, step_to_points
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import se2, symmetric, transform, yaw
from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.kinds import Distance, Length, VoxelSize
from rbtm_bench.core.types import Array

Positive = Annotated[float, Gt(0)]
Share = Annotated[float, Gt(0), Le(1)]

PLANAR = [0, 1, 5]
"""x, y, rz among the six of ``Alignment.information``."""
MIN_MATCHES = 3

STOPPED, CYCLED, UNFINISHED, LOST = range(4)
"""How the iterations ended: a step under epsilon; a pose met before; neither; too few matches."""


class PointToLineICP(Backend):
    """Censi, "An ICP variant using a point-to-line metric", ICRA 2008; our own code.

    Parameters are named after those of the author's C implementation, csm. Each source point p is
    matched to a segment: its nearest target point q within ``max_correspondence_distance`` m and
    the nearer of that point's neighbours on either side. With ``metric`` point_to_line the step
    minimises the sum of (n.(R p + t - q))^2, n the segment's normal: the paper's quadratic form
    with a Lagrange multiplier, solved exactly. With point_to_point (its "vanilla" ICP) it minimises
    the sum of |R p + t - f|^2, f the nearest point on both segments to where p is now.

    Trimming: the best ``outliers_max_percent`` (a share) of the matches count (csm:
    outliers_maxPerc), provided that they are no farther than ``outliers_adaptive_multiplier``
    (csm: outliers_adaptive_mult) times the distance within which the share
    ``outliers_adaptive_order`` of all matches lies. ``outliers_remove_doubles`` keeps, of the
    source points with the same nearest target point, only the nearest; csm does so by default but
    for points up to 3 times as far.

    Three parameters of ours. Matches nearer than ``trim_floor`` m are never trimmed before the
    iterations have ended once (0: they may be, as in csm). Between scans of little noise most
    matches, those on walls along the way, fit exactly whatever the guess; limits that follow from
    them drop every match that tells the motion along those walls, and the scan stays at its guess.
    The default is twice 10 mm of noise and 10 mm of the guess's error. Segments are at least
    ``min_segment_length`` m long (0: to the next point, as in csm), since two points closer
    together than the noise give no direction. And limits as tight as csm's also drop the few good
    matches that tell the way along a corridor: once the iterations have ended, the limit becomes
    ``outliers_refine_multiplier`` times the adaptive distance alone, and they go on
    (0: they do not, as in csm).

    Iterations end with a step under ``epsilon_xy`` m and ``epsilon_theta`` rad, or where they come
    back to an earlier pose: then the pose with the least mean error since is taken.
    ``max_iterations`` counts all of them. ``converged``: ended in one of these two ways; False when
    out of iterations, or with fewer than 3 matches or the share ``fail_percent`` of the source
    points. ``library_fitness`` is the share of source points matched after trimming,
    ``library_rmse`` (m) their RMS distance to the segments.

    The information is the inverse of Censi's covariance (ICRA 2007) for ranges known to ``sigma``
    m in both scans, along beams from the origins of their frames (in a merged target that is only
    nearly so); 0 in directions that no segment holds, or only by its noise. It knows nothing of
    wrong matches, nor of the guess that a step along an unseen direction starts from.
    Deterministic.
    """

    library = "our own (MIT)"
    converged_means = "last step below the epsilons, or a pose met before; in time, with matches"
    repeats = "same bits; one thread"
    dimensions = ("2d",)

    def __init__(
        self,
        max_correspondence_distance: Distance = 0.3,
        voxel_size: VoxelSize = 0.0,
        metric: Literal["point_to_line", "point_to_point"] = "point_to_line",
        max_iterations: Annotated[int, Ge(1)] = 50,
        epsilon_xy: Positive = 1e-4,
        epsilon_theta: Positive = 1e-4,
        outliers_max_percent: Share = 0.9,
        outliers_adaptive_order: Share = 0.7,
        outliers_adaptive_multiplier: Positive = 2.0,
        outliers_refine_multiplier: Annotated[float, Ge(0)] = 3.0,
        outliers_remove_doubles: bool = False,
        trim_floor: Length = 0.03,
        min_segment_length: Annotated[float, Ge(0)] = 0.1,
        fail_percent: Annotated[float, Ge(0), Le(1)] = 0.05,
        sigma: Positive = 0.01,
    ) -> None:
        super().__init__(max_correspondence_distance, voxel_size)
        self.min_segment_length = min_segment_length
        self.sigma = sigma
        self.settings = PlicpSettings(
            distance=max_correspondence_distance,
            to_line=metric == "point_to_line",
            max_iterations=max_iterations,
            epsilon_xy=epsilon_xy,
            epsilon_theta=epsilon_theta,
            max_percent=outliers_max_percent,
            adaptive_order=outliers_adaptive_order,
            adaptive_multiplier=outliers_adaptive_multiplier,
            refine_multiplier=outliers_refine_multiplier,
            remove_doubles=outliers_remove_doubles,
            min_share=fail_percent,
            floor=trim_floor,
        )
        corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)
        square = Prepared(corners, True, self.build(corners, True))
        self.align(square, square, np.eye(4))  # compiles the kernels

    def build(self, points: Array, planar: bool) -> Surface:
        if not planar:
            raise BackendError("plicp registers planar scans only")
        return surface_of(points, self.min_segment_length)

    def join(self, parts: Sequence[tuple[Prepared, Array]]) -> Prepared:
        """Points one after the other, segments as each scan has them; sorted along the axis that
        suits the last."""
        points = np.concatenate([transform(T, part.points) for part, T in parts])
        last, T_target_last = parts[-1]
        turn = last.native.turn - float(yaw(T_target_last))
        surface = joined_surface(points, [part.native for part, _ in parts], turn)
        return Prepared(points, True, surface, joined_key(parts))

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        moving, surface = source.native, target.native
        # between the turned frames, in which the points of both scans are sorted
        guess = turned(T_target_source, surface.turn, -moving.turn)
        pose, ending, iterations, matches, mean_square = iterate(
            moving.points.xy, surface, guess, self.settings
        )
        T = se2(*turned(se2(*pose), -surface.turn, moving.turn))
        if ending == LOST:
            return Alignment(T, converged=False, iterations=iterations)
        of_turned = motion_information(
            moving.points.xy, surface.points.xy, matches, pose, self.sigma
        )
        R = se2(0, 0, moving.turn)[:3, :3]
        information = np.zeros((6, 6))
        information[np.ix_(PLANAR, PLANAR)] = symmetric(R.T @ of_turned @ R)
        return Alignment(
            T,
            converged=ending != UNFINISHED,
            iterations=iterations,
            information=information,
            library_fitness=len(matches.source) / len(source.points),
            library_rmse=float(np.sqrt(mean_square)),
        )


def turned(T: Array, before: float, after: float) -> Array:
    """The pose (x, y, theta) of a planar motion T between two turns in rad."""
    c, s = math.cos(before), math.sin(before)
    x, y = T[0, 3], T[1, 3]
    theta = math.atan2(T[1, 0], T[0, 0]) + (before + after)
    return np.array([c * x - s * y, s * x + c * y, theta])


@kernel
def iterate(
    xy: Array, surface: Surface, guess: Array, settings: PlicpSettings
) -> tuple[Array, int, int, Matches, float]:
    """Match, trim, solve, and again.

    Source points ``xy`` (N, 2) and the ``guess`` (x, y, theta) -> the pose, how it ended, the
    iterations, the matches at that pose and their mean square distance (m^2).
    """
    n, most, target = len(xy), settings.max_iterations, surface.points.xy
    least = max(MIN_MATCHES, settings.min_share * n)
    moved, ints = np.empty((n, 2)), np.empty((3, n), np.int64)
    matches = Matches(ints[0], ints[1], ints[2], np.empty(n))
    poses, errors = np.empty((most + 1, 3)), np.empty(most)
    poses[0] = guess
    ending, k, best, since, refines = UNFINISHED, 0, 0, 0, False
    while k < most and ending == UNFINISHED:
        count, errors[k] = match(xy, surface, poses[k], settings, refines, moved, matches)
        if count < least:
            break
        if settings.to_line:
            step = step_to_lines(moved, target, matches, count)
        else:
            step = step_to_points(moved, target, matches, count)
        compose(step, poses[k], poses[k + 1])
        k += 1
        best = k
        if is_near(poses[k], poses[k - 1], settings):
            ending = STOPPED
        for i in range(since, k - 1):
            if ending == UNFINISHED and is_near(poses[k], poses[i], settings):
                ending, best = CYCLED, i + int(np.argmin(errors[i:k]))
        if ending != UNFINISHED and k < most and settings.refine_multiplier > 0.0 and not refines:
            ending, refines, since = UNFINISHED, True, k
            poses[k] = poses[best]
            best = k
    count, error = match(xy, surface, poses[best], settings, refines, moved, matches)
    if count < least:
        ending = LOST
    return poses[best], ending, k, shortened(matches, count), error


@kernel
def is_near(a: Array, b: Array, settings: PlicpSettings) -> bool:
    """True if two poses (x, y, theta) differ by less than epsilon."""
    shift = np.hypot(a[0] - b[0], a[1] - b[1])
    return shift < settings.epsilon_xy and abs(a[2] - b[2]) < settings.epsilon_theta


@kernel
def compose(step: Array, pose: Array, out: Array) -> None:
    """``out``: the pose (x, y, theta) after a step of the source in the target frame."""
    c, s = np.cos(step[2]), np.sin(step[2])
    out[0] = c * pose[0] - s * pose[1] + step[0]
    out[1] = s * pose[0] + c * pose[1] + step[1]
    out[2] = pose[2] + step[2]
