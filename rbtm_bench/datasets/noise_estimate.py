"""How noisy a data set's ranges and odometry are, estimated from the data.

Robust estimates of a scale: edges in scans and slips of wheels are outliers, not noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.geometry import inverse, rotation_angle, translation_norm
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.association import nearest
from rbtm_bench.datasets.base import Dataset, Relations

TO_SIGMA = 1.0 / 0.6745
"""From the median of absolute values to a normal distribution's standard deviation."""

BEAM_SCANS, CLOUD_SCANS, CLOUD_POINTS, NEIGHBOURS = 50, 5, 1000, 8
SMOOTH = 0.1
"""Ranges of neighbouring beams that differ by more than this share are an edge."""

MOVED_M, MOVED_RAD = 0.005, np.deg2rad(0.25)
"""A step longer than either is motion."""
FEWEST_MOTIONS = 20
LONGEST_S = 5.0
"""s; longer relations say more of headings far back than of the steps between."""
DEFAULT_SHARE = 0.02
"""Of the distance and of the rotation, where nothing measures the odometry: wheels on a floor."""


@dataclass(frozen=True)
class OdometryError:
    """Standard deviations of an increment: ``translation`` a share of its length (each axis);
    ``rotation`` a share of its angle, ``rotation_rad`` on top for every one that moves.
    ``source``: what it was measured by, "default" for a guess."""

    translation: float
    rotation: float
    rotation_rad: float
    source: str


def range_noise(dataset: Dataset) -> float:
    """The standard deviation (m) of a range, from up to 50 scans (5 clouds) over the data set."""
    count = BEAM_SCANS if dataset.has_beams else CLOUD_SCANS
    chosen = np.unique(np.linspace(0, len(dataset) - 1, count).astype(int))
    scans = [dataset[int(index)] for index in chosen]
    if dataset.has_beams:
        off = [beam_residuals(s.ranges, s.angles) for s in scans if s.ranges is not None]
    else:
        off = [plane_residuals(scan.points) for scan in scans]
    residuals = np.concatenate(off) if off else np.zeros(0)
    return float(TO_SIGMA * np.median(np.abs(residuals))) if len(residuals) else 0.0


def beam_residuals(ranges: Array, angles: Array | None) -> Array:
    """Second differences along beams (B,), scaled to the noise of one range (m).

    Taken of 1/r, where a straight wall has none whatever its slope: 1/r is a cosine of the angle.
    """
    if angles is None or len(ranges) < 3:
        return np.zeros(0)
    left, mid, right = ranges[:-2], ranges[1:-1], ranges[2:]
    smooth = (np.abs(left - mid) < SMOOTH * mid) & (np.abs(right - mid) < SMOOTH * mid)
    left, mid, right = left[smooth], mid[smooth], right[smooth]
    step = float(np.median(np.diff(angles)))
    off = 1.0 / left + 1.0 / right - 2.0 * np.cos(step) / mid
    return np.asarray(off * mid**2 / np.sqrt(6.0))


def plane_residuals(points: Array) -> Array:
    """Distances (m) of up to 1000 points (N, 3) from the planes of their eight neighbours."""
    from scipy.spatial import cKDTree

    if len(points) <= NEIGHBOURS:
        return np.zeros(0)
    chosen = np.unique(np.linspace(0, len(points) - 1, CLOUD_POINTS).astype(int))
    near = cKDTree(points).query(points[chosen], NEIGHBOURS + 1)[1][:, 1:]
    around = points[near]
    centre = around.mean(axis=1)
    spread = around - centre[:, None]
    normals = np.linalg.eigh(np.swapaxes(spread, 1, 2) @ spread)[1][:, :, 0]
    off = ((points[chosen] - centre) * normals).sum(axis=1)
    return np.asarray(off / np.sqrt(1.0 + 1.0 / NEIGHBOURS))


def odometry_error(
    stamps: Array, odometry: Array, truth: Array | None, relations: Relations | None
) -> OdometryError:
    """The error of the odometry's increments, against the truth or relations over a few seconds.

    ``stamps`` (N,) s, ``odometry`` and ``truth`` (N, 4, 4), the latter NaN where not known. With
    fewer than 20 motions to compare: 2 % of the distance and of the rotation.
    """
    if truth is not None:
        known = np.asarray(np.isfinite(truth).all(axis=(1, 2)))
        first = np.flatnonzero(known[:-1] & known[1:])
        motions = inverse(truth[first]) @ truth[first + 1]
        measured = _against(odometry, first, first + 1, motions, "truth")
    elif relations is not None:
        i, j = (nearest(stamps, ends, 1e-4) for ends in (relations.start, relations.end))
        short = np.abs(relations.end - relations.start) <= LONGEST_S
        used = (i >= 0) & (j > i) & short
        measured = _against(odometry, i[used], j[used], relations.T_start_end[used], "relations")
    else:
        measured = None
    return measured or OdometryError(DEFAULT_SHARE, DEFAULT_SHARE, 0.0, "default")


def _against(
    odometry: Array,
    start: NDArray[np.intp],
    end: NDArray[np.intp],
    T_start_end: Array,
    source: str,
) -> OdometryError | None:
    """The error that motions over one or more increments show: errors of increments add up as
    squares, so each is divided by the root of the sum of squared lengths, or by the number."""
    steps = inverse(odometry[:-1]) @ odometry[1:]
    moves = moving(steps)
    squares = np.concatenate([[0.0], np.cumsum(translation_norm(steps) ** 2)])
    numbers = np.concatenate([[0], np.cumsum(moves)])
    length, number = squares[end] - squares[start], numbers[end] - numbers[start]
    used = (number > 0) & (length > MOVED_M**2)
    if used.sum() < FEWEST_MOTIONS:
        return None
    E = inverse(T_start_end[used]) @ inverse(odometry[start[used]]) @ odometry[end[used]]
    shift = E[:, :2, 3] / np.sqrt(length[used])[:, None]
    turn = rotation_angle(E) / np.sqrt(number[used])
    scale = [float(TO_SIGMA * np.median(np.abs(values))) for values in (shift, turn)]
    return OdometryError(scale[0], 0.0, scale[1], source)


def moving(steps: Array) -> Array:
    """Which motions (N, 4, 4) are no standing still."""
    return np.asarray((translation_norm(steps) > MOVED_M) | (rotation_angle(steps) > MOVED_RAD))
