"""Polar scan matching (Diosi and Kleeman 2005, 2007): our own code, from the papers."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge, Gt, Le

from rbtm_bench.backends.base import MIN_POINTS, Alignment, Backend, Prepared
from rbtm_bench.backends.polar_scan import Bins, PolarScan, bins_of, polar_scan, project
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import se2, yaw
from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.kinds import Distance, VoxelSize
from rbtm_bench.core.types import Array

Positive = Annotated[float, Gt(0)]

MIN_SHARE = 40 / 181
"""How many bins must be seen in both scans, of those that the emptier one sees (the papers' 40
of 181)."""
SMALL_CORRECTIONS = 3
"""So many small corrections in a row end the search."""
WEIGHT_DIVISOR = 50.0
"""What the weighting factor is divided by when only the best matches are to count."""
SMALLEST_GAIN = 0.25
METRES_PER_DEGREE = 0.01
"""The papers add up cm and degrees."""
FINER = 0.75
"""A target whose bins are narrower than this share of the source's holds several scans."""
SMALLEST_DEVIATION = 1e-3
"""m, of ranges: identical scans would give infinite information."""
STEEPEST = 8.0
"""A surface at which the range grows by more than this times itself a radian (83 deg from facing
the beam) has no reliable direction."""


class PsmSettings(NamedTuple):
    """What the kernels need to know, in m and rad."""

    shift: float
    C: float
    change_weight_iteration: int
    max_error: float
    stop_condition: float
    max_iterations: int
    min_range: float
    backtracking: float


class Model(NamedTuple):
    """A scan both ways: as the current scan, and as the reference with its ranges (B,) m."""

    scan: PolarScan
    bins: Bins
    ranges: Array


class PolarScanMatching(Backend):
    """Matches ranges of the same bearing, by our own code after A. Diosi and L. Kleeman, "Laser
    scan matching in polar coordinates with application to SLAM" (IROS 2005) and "Fast laser scan
    matching using polar coordinates" (IJRR 2007). Deterministic; one thread.

    A scan becomes ranges over bearings: median filter (5 bins), segmentation at jumps of more
    than ``segment_max_distance`` m. The current scan is projected to where the reference was taken
    (hidden surfaces and backs of surfaces left out), then in turn
    1. the bearings are shifted by up to ``max_orientation_shift`` deg; the shift of the least
       mean absolute difference of ranges, refined by a parabola, is the rotation;
    2. the translation (dx, dy) minimises the sum of w (dr - cos(b) dx - sin(b) dy)^2 over
       bearings b, with w = C / (C + dr^2) and C = ``weighting_factor`` m^2, divided by 50 from
       iteration ``change_weight_iteration`` on; |dr| >= ``max_error`` m does not count,
    until three corrections in a row are below ``stop_condition``, |dx| + |dy| in m plus 0.01 m a
    degree, or for ``max_iterations``.

    Three things differ from the papers. A difference counts at most ``max_error`` in step 1, as
    in step 2: without, a few doorways outvote the walls. Step 2 takes each point to move along
    its own beam, so walls seen at an angle make it go too far, by up to twice; each time it turns
    back on the step before, later steps shrink by ``backtracking``, at least to a quarter (1: the
    papers' own steps, which in corridors may swing up without end). And ``max_range`` (m, nothing
    beyond is used) is not 10 m but whatever the data set keeps.

    Other parameters: ``min_range`` m, nearer points are not used; ``bins`` around the full
    circle, None: as many as make them as wide as the median gap of the points' bearings.
    ``max_correspondence_distance`` is the evaluator's only.

    ``converged`` is True if the corrections became small in time, False if they did not, or if
    too few bearings are seen in both scans (the result is then the last pose). The library's
    fitness is the share of the seen bearings with |dr| < max_error, its RMSE that of their dr.
    The papers' covariance is a guess that knows two cases (corridor or not); the information
    given is that of the range differences instead, with the directions of surfaces taken from the
    reference, over their weighted variance (at least 1 mm squared).
    """

    library = "our own (MIT)"
    converged_means = "three corrections in a row below `stop_condition`, within `max_iterations`"
    repeats = "same bits; one thread"
    dimensions = ("2d",)

    def __init__(
        self,
        max_correspondence_distance: Distance = 0.3,
        voxel_size: VoxelSize = 0.0,
        max_orientation_shift: Annotated[float, Gt(0), Le(180)] = 20.0,
        weighting_factor: Positive = 0.49,
        change_weight_iteration: Annotated[int, Ge(0)] = 10,
        max_error: Positive = 1.0,
        stop_condition: Positive = 0.004,
        max_iterations: Annotated[int, Ge(2)] = 30,
        backtracking: Annotated[float, Gt(0), Le(1)] = 0.5,
        segment_max_distance: Positive = 0.2,
        min_range: Annotated[float, Ge(0)] = 0.1,
        max_range: Positive | None = None,
        bins: Annotated[int, Ge(36)] | None = None,
    ) -> None:
        super().__init__(max_correspondence_distance, voxel_size)
        self.segment_max_distance = segment_max_distance
        self.min_range = min_range
        self.max_range = np.inf if max_range is None else max_range
        self.bins = bins
        self.settings = PsmSettings(
            shift=float(np.deg2rad(max_orientation_shift)),
            C=weighting_factor,
            change_weight_iteration=change_weight_iteration,
            max_error=max_error,
            stop_condition=stop_condition,
            max_iterations=max_iterations,
            min_range=min_range,
            backtracking=backtracking,
        )
        _compile(self)

    def build(self, points: Array, planar: bool) -> Model:
        if not planar:
            raise BackendError("polar scan matching is for planar scans")
        return self._model(points, bins_of(points, self.bins))

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        current: Model = source.native
        reference: Model = target.native
        if reference.bins.step < FINER * current.bins.step:
            # one scan's bins, or far walls would be seen through the gaps between near points
            bins = bins_of(target.points, len(current.bins.cosine))
            reference = self._model(target.points, bins)
        start = (T_target_source[0, 3], T_target_source[1, 3], float(yaw(T_target_source)))
        pose, iterations, converged = match(
            current.scan, reference.ranges, reference.bins, start, self.settings
        )
        H, deviation, share = information(
            current.scan, reference.ranges, reference.bins, pose, self.settings
        )
        full = np.zeros((6, 6))
        full[np.ix_((0, 1, 5), (0, 1, 5))] = H
        T = se2(*pose)
        return Alignment(T, converged, iterations, full, share, deviation)

    def _model(self, points: Array, bins: Bins) -> Model:
        scan = polar_scan(points, bins, self.min_range, self.max_range, self.segment_max_distance)
        if not scan.joined.any():
            raise BackendError("no two neighbouring points on one surface within range")
        return Model(scan, bins, project(scan, bins, (0.0, 0.0, 0.0), self.min_range))


def _compile(method: PolarScanMatching) -> None:
    """Call every kernel once, so that no registration is charged for compiling them."""
    turn = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    points = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(40)])
    bins = bins_of(points, 40)
    scan = polar_scan(points, bins, 0.1, np.inf, 0.2)
    ranges = project(scan, bins, (0.0, 0.0, 0.0), 0.1)
    match(scan, ranges, bins, (0.0, 0.0, 0.0), method.settings)
    information(scan, ranges, bins, (0.0, 0.0, 0.0), method.settings)


@kernel
def match(
    source: PolarScan,
    reference: Array,
    bins: Bins,
    start: tuple[float, float, float],
    settings: PsmSettings,
) -> tuple[tuple[float, float, float], int, bool]:
    """The pose (x m, y m, theta rad) of ``source`` in the frame of the reference ranges (B,) m,
    the iterations taken, and whether the corrections became small."""
    x, y, theta = start
    twice = np.concatenate((reference, reference))
    last_x, last_y, gain = 0.0, 0.0, 1.0
    small = 0
    for iteration in range(settings.max_iterations):
        ranges = project(source, bins, (x, y, theta), settings.min_range)
        if iteration % 2 == 0:
            turn = orientation(twice, ranges, settings.shift / bins.step, settings.max_error)
            if np.isnan(turn):
                return (x, y, theta), iteration, False
            theta += turn * bins.step
            correction = METRES_PER_DEGREE * np.rad2deg(abs(turn * bins.step))
        else:
            late = iteration >= settings.change_weight_iteration
            C = settings.C / WEIGHT_DIVISOR if late else settings.C
            dx, dy = translation(reference, ranges, bins, C, settings.max_error)
            if np.isnan(dx):
                return (x, y, theta), iteration, False
            if dx * last_x + dy * last_y < 0.0:
                gain = max(gain * settings.backtracking, min(gain, SMALLEST_GAIN))
            last_x, last_y = dx, dy
            x += gain * dx
            y += gain * dy
            correction = gain * (abs(dx) + abs(dy))
        small = small + 1 if correction < settings.stop_condition else 0
        if small == SMALL_CORRECTIONS:
            return (x, y, theta), iteration + 1, True
    return (x, y, theta), settings.max_iterations, False


@kernel
def orientation(twice: Array, ranges: Array, window: float, most: float) -> float:
    """By how many bins ``ranges`` (B,) m must turn for the least mean absolute difference from the
    reference, given ``twice`` in a row (2 B,); a difference counts at most ``most`` m. NaN if no
    shift within ``window`` bins has enough bins in common."""
    count = len(ranges)
    seen = min(np.isfinite(twice[:count]).sum(), np.isfinite(ranges).sum())
    needed = max(float(MIN_POINTS), MIN_SHARE * seen)
    half = min(max(1, int(np.floor(window + 1e-6))), count // 2 - 1)
    errors = np.full(2 * half + 1, np.inf)
    best = half
    for s in range(-half, half + 1):
        start = s % count
        total, n = 0.0, 0
        for b in range(count):
            difference = abs(twice[start + b] - ranges[b])
            if difference < np.inf:  # seen by both; false for infinity less infinity, too
                total += min(difference, most)
                n += 1
        if n >= needed:
            errors[s + half] = total / n
        closer = abs(s) < abs(best - half)
        if errors[s + half] < errors[best] or (errors[s + half] == errors[best] and closer):
            best = s + half
    if errors[best] == np.inf:
        return np.nan
    if 0 < best < 2 * half:
        before, after = errors[best - 1], errors[best + 1]
        bend = before - 2.0 * errors[best] + after
        if 0.0 < bend < np.inf:
            return best - half + 0.5 * (before - after) / bend
    return float(best - half)


@kernel
def translation(
    reference: Array, ranges: Array, bins: Bins, C: float, max_error: float
) -> tuple[float, float]:
    """The translation (m) that makes ``ranges`` (B,) m those of the reference (B,) m, as if
    points moved along their beams; NaN if it is not determined."""
    xx, xy, yy, bx, by, n = 0.0, 0.0, 0.0, 0.0, 0.0, 0
    for b in range(len(reference)):
        dr = reference[b] - ranges[b]
        if not abs(dr) < max_error:
            continue
        w, c, s = C / (C + dr * dr), bins.cosine[b], bins.sine[b]
        xx += w * c * c
        xy += w * c * s
        yy += w * s * s
        bx += w * c * dr
        by += w * s * dr
        n += 1
    determinant = xx * yy - xy * xy
    if n < MIN_POINTS or determinant <= 1e-9 * (xx + yy) ** 2:
        return np.nan, np.nan
    return (yy * bx - xy * by) / determinant, (xx * by - xy * bx) / determinant


@kernel
def information(
    source: PolarScan,
    reference: Array,
    bins: Bins,
    pose: tuple[float, float, float],
    settings: PsmSettings,
) -> tuple[Array, float, float]:
    """Information (3, 3) of a small motion x, y (m), rz (rad) of the source in its own frame, the
    weighted RMS (m) of the range differences, and the share of seen bearings where they count.

    Where the range changes by r' a radian, moving a point by d changes it by (u - r'/r v) . d,
    with u along the beam and v across it: the surface, not the point, is what the beam meets.
    """
    x, y, theta = pose
    ranges = project(source, bins, pose, settings.min_range)
    count = len(reference)
    H = np.zeros((3, 3))
    j = np.empty(3)
    C = settings.C / WEIGHT_DIVISOR
    squares, weights, seen, matched = 0.0, 0.0, 0, 0
    cosine, sine = np.cos(theta), np.sin(theta)
    for b in range(count):
        seen += ranges[b] < np.inf
        dr, r = reference[b] - ranges[b], reference[b]
        if not abs(dr) < settings.max_error:
            continue
        matched += 1
        w = C / (C + dr * dr)
        squares += w * dr * dr
        weights += w
        # of both sides the flatter one: nothing spans the edge of an object
        left = (r - reference[(b - 2) % count]) / (2.0 * bins.step * r)
        right = (reference[(b + 2) % count] - r) / (2.0 * bins.step * r)
        slope = left if abs(left) < abs(right) else right
        if not abs(slope) < STEEPEST:
            continue
        c, s = bins.cosine[b], bins.sine[b]
        nx, ny = c + slope * s, s - slope * c
        px, py = r * c - x, r * s - y  # from the source's place to the point, target's axes
        j[0] = cosine * nx + sine * ny
        j[1] = cosine * ny - sine * nx
        j[2] = px * ny - py * nx
        H += w * np.outer(j, j)
    if matched == 0:
        return H, np.nan, 0.0
    deviation = np.sqrt(squares / weights)
    return H / max(deviation, SMALLEST_DEVIATION) ** 2, deviation, matched / seen
