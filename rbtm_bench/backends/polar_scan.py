"""A planar scan as ranges over bearings, compiled: what polar scan matching works on.

``polar_scan`` gathers points in bearing bins, filters and segments them; ``project`` says which
ranges another place would see of them. Bins go around the full circle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.types import Array

MEDIAN_WINDOW = 5
"""Bins that the median filter looks at: it removes what is one or two beams wide."""
LARGEST_GAP = 3
"""Points more bins apart than this (one or two lost returns) are not on one surface."""
FEWEST_BINS, MOST_BINS = 36, 3600
SAME_BEARING = 1e-6
"""Points closer in bearing (rad) than this tell nothing about the spacing of beams."""
EDGE = 1e-6
"""Share of a bin that a bearing may be off by rounding."""


class Bins(NamedTuple):
    """Directions (B,) of the bins' centres: the bearing of the first, ``origin`` rad, and the
    ``step`` to the next, rad."""

    cosine: Array
    sine: Array
    origin: float
    step: float


class PolarScan(NamedTuple):
    """Points (K, 2) m in the order of bearing after filtering, a bin each. ``joined`` (K,) says
    whether a point and the next one (the last: and the first) are on one surface."""

    xy: Array
    joined: NDArray[np.bool_]


def bins_of(points: Array, count: int | None) -> Bins:
    """``count`` bins around the circle; None: as far apart as the median of the points' (N, >= 2)
    bearings. The bins' centres lie where most bearings do."""
    bearing = np.sort(np.arctan2(points[:, 1], points[:, 0]))
    if count is None:
        gaps = np.diff(bearing)
        gaps = gaps[gaps > SAME_BEARING]
        spacing = float(np.median(gaps)) if len(gaps) else 1.0
        count = int(np.clip(round(2.0 * np.pi / spacing), FEWEST_BINS, MOST_BINS))
    step = 2.0 * np.pi / count
    phase = np.angle(np.exp(1j * count * bearing).mean())
    origin = float(phase) / count
    centres = origin + step * np.arange(count)
    return Bins(np.cos(centres), np.sin(centres), origin, step)


@kernel
def polar_scan(
    points: Array, bins: Bins, min_range: float, max_range: float, max_jump: float
) -> PolarScan:
    """Points (N, >= 2) m, one a bin, median filtered and segmented.

    Of several points in a bin, the mean of those at most ``max_jump`` m behind the nearest.
    Points out of ``min_range`` ... ``max_range`` m are left out. Neighbours are on one surface if
    their ranges differ by less than ``max_jump`` m, or if the range goes on as it did before.
    """
    count = len(bins.cosine)
    place = np.empty(len(points), dtype=np.int64)
    length = np.empty(len(points))
    nearest = np.full(count, np.inf)
    for i in range(len(points)):
        r = np.hypot(points[i, 0], points[i, 1])
        bearing = np.arctan2(points[i, 1], points[i, 0])
        b = int(np.round((bearing - bins.origin) / bins.step)) % count
        place[i], length[i] = b, r
        if min_range < r < max_range and r < nearest[b]:
            nearest[b] = r
    sums = np.zeros((count, 3))
    for i in range(len(points)):
        b = place[i]
        if min_range < length[i] < max_range and length[i] <= nearest[b] + max_jump:
            sums[b, 0] += points[i, 0]
            sums[b, 1] += points[i, 1]
            sums[b, 2] += 1.0
    filled = np.flatnonzero(sums[:, 2] > 0.0)
    xy = np.empty((len(filled), 2))
    for k in range(len(filled)):
        xy[k] = sums[filled[k], :2] / sums[filled[k], 2]
    ranges = _median_filtered(np.hypot(xy[:, 0], xy[:, 1]), filled, count)
    for k in range(len(filled)):
        xy[k] *= ranges[k] / np.hypot(xy[k, 0], xy[k, 1])
    return PolarScan(xy, _joined(ranges, filled, count, max_jump))


@kernel
def _median_filtered(ranges: Array, filled: NDArray[np.int64], count: int) -> Array:
    """Each range (K,) as the median of those within half a window of its bin."""
    half, total = MEDIAN_WINDOW // 2, len(ranges)
    window = np.empty(2 * half + 1)
    out = np.empty(total)
    for k in range(total):
        window[0], n = ranges[k], 1
        for direction in (-1, 1):
            for j in range(1, min(half, total - 1) + 1):
                other = (k + direction * j) % total
                if (direction * (filled[other] - filled[k])) % count > half or n == total:
                    break
                window[n] = ranges[other]
                n += 1
        out[k] = np.median(window[:n]) if n % 2 else ranges[k]
    return out


@kernel
def _joined(
    ranges: Array, filled: NDArray[np.int64], count: int, max_jump: float
) -> NDArray[np.bool_]:
    """Whether each of the ranges (K,) and the next one are on one surface."""
    total = len(ranges)
    out = np.zeros(total, dtype=np.bool_)
    if total < 2:
        return out
    for k in range(total):
        after, before = (k + 1) % total, (k - 1) % total
        gap = (filled[after] - filled[k]) % count
        since = (filled[k] - filled[before]) % count
        if gap > LARGEST_GAP:
            continue
        change = ranges[after] - ranges[k]
        expected = (ranges[k] - ranges[before]) * gap / since if since <= LARGEST_GAP else 0.0
        out[k] = min(abs(change), abs(change - expected)) < max_jump
    return out


@kernel
def project(
    scan: PolarScan, bins: Bins, pose: tuple[float, float, float], min_range: float
) -> Array:
    """Ranges (B,) m of a scan as seen from elsewhere, where it was taken at ``pose`` (x m, y m,
    theta rad); infinity where nothing is seen, only the back of a surface, or something nearer
    than ``min_range`` m. Between neighbours of one surface the surface is taken to be straight.
    """
    x, y, theta = pose
    c, s = np.cos(theta), np.sin(theta)
    count, total = len(bins.cosine), len(scan.joined)
    ranges = np.full(count, np.inf)
    is_back = np.zeros(count, dtype=np.bool_)
    for k in range(total):
        if not scan.joined[k]:
            continue
        after = (k + 1) % total
        ax = c * scan.xy[k, 0] - s * scan.xy[k, 1] + x
        ay = s * scan.xy[k, 0] + c * scan.xy[k, 1] + y
        bx = c * scan.xy[after, 0] - s * scan.xy[after, 1] + x
        by = s * scan.xy[after, 0] + c * scan.xy[after, 1] + y
        area = ax * by - ay * bx
        back = area < 0.0  # bearings fall where they rose: seen from behind
        if back:
            ax, ay, bx, by, area = bx, by, ax, ay, -area
        start = (np.arctan2(ay, ax) - bins.origin) / bins.step
        width = np.arctan2(area, ax * bx + ay * by) / bins.step
        dx, dy = bx - ax, by - ay
        for place in range(int(np.ceil(start - EDGE)), int(np.floor(start + width + EDGE)) + 1):
            b = place % count
            across = bins.cosine[b] * dy - bins.sine[b] * dx
            if across <= 0.0:
                continue  # along the ray
            r = area / across
            if min_range < r < ranges[b]:
                ranges[b], is_back[b] = r, back
    for b in range(count):
        if is_back[b]:
            ranges[b] = np.inf
    return ranges
