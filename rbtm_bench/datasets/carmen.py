"""Robot logs in the CARMEN format: a planar laser, wheel odometry, perhaps a corrected path."""

from __future__ import annotations

import hashlib
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt
from numpy.typing import NDArray

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import Dataset, Relations, beam_points
from rbtm_bench.datasets.carmen_log import (
    BEAM_ANGLES_DEG,
    CarmenLog,
    parse_log,
    parse_relations,
)
from rbtm_bench.datasets.files import read_bytes, unpacked_lines

VERSION = "carmen-1"
"""Part of the fingerprint: change it whenever the same file and settings give other scans."""

POSE_TOLERANCE_M, POSE_TOLERANCE_DEG = 0.01, 0.5
"""Two pose triples further apart than this are not copies of each other."""

RESET_TOLERANCE = 1e-4
"""An ODOM line this close (m, rad) to the FLASER pose before it is a copy of it."""

NO_RETURN_BAND = 0.1
NO_RETURN_SHARE = 0.001
NO_RETURN_READINGS = 10

NOMINAL_STEP = 0.1
"""s between scans of a log that has lost its times."""


class Carmen(Dataset):
    """The FLASER lines of a CARMEN log (plain, gzip or bzip2, recognised by content).

    **Poses.** A raw log repeats its odometry in the FLASER lines. A corrected log holds a
    corrected path in both of their pose triples: that is ``ground_truth``, never odometry.
    ``corrected`` says which it is; "auto" calls a log corrected if both triples are more than
    0.01 m or 0.5 deg off the ODOM line before, for more than half of the scans. A corrected log
    takes its odometry from the ODOM lines; where these jump to the corrected pose after every
    scan (as in the Radish collection), the jumps are left out, else the odometry would never
    drift. A log with nothing but those jumps has no odometry at all.

    **Returns.** A range is no return if it is NaN or infinite, at most ``min_range`` (m), or at
    least ``max_range`` (m). ``max_range`` None finds out: the longest range L of the log means "no
    return" if it makes up 0.1 % of the readings and at least 10 of them; then ranges from L - 0.1 m
    on are dropped, and in any case those from the log's own robot_front_laser_max on.

    **Order and thinning**, in this sequence: ``order`` (file, or time by stamp), every
    ``stride``-th scan, scans that moved ``min_distance`` (m) or turned ``min_angle_deg`` since the
    last one kept, judged by odometry (0 turns a criterion off), at most ``max_scans``.

    Stamps are the ipc_timestamp (s). If at most half of them are distinct, the log has lost its
    times: stamps are then 0.1 s apart and ``has_stamps`` is False.

    ``relations`` is a file of reference relations; ``on_error`` "skip" leaves malformed lines out
    and counts them in ``skipped``. Raises ``DataError`` for files that cannot be read or parsed,
    ``ConfigError`` for settings that this log cannot meet.
    """

    planar = True
    has_beams = True

    def __init__(
        self,
        path: str,
        relations: str | None = None,
        corrected: Literal["auto"] | bool = "auto",
        max_range: Annotated[float, Gt(0)] | None = None,
        min_range: Annotated[float, Ge(0)] = 0.0,
        stride: Annotated[int, Ge(1)] = 1,
        min_distance: Annotated[float, Ge(0)] = 0.0,
        min_angle_deg: Annotated[float, Ge(0)] = 0.0,
        max_scans: Annotated[int, Ge(1)] | None = None,
        order: Literal["file", "time"] = "file",
        on_error: Literal["raise", "skip"] = "raise",
    ) -> None:
        content = hashlib.sha256()
        log = parse_log(path, unpacked_lines(path, content), on_error)
        self.skipped = log.skipped
        self.corrected = is_corrected(log) if corrected == "auto" else corrected
        odometry, ground_truth = _poses(path, log, self.corrected)
        self.has_odometry = odometry is not None
        self.has_ground_truth = ground_truth is not None
        self.has_stamps = 2 * len(np.unique(log.stamps)) > len(log.stamps)
        stamps: Array = log.stamps
        if not self.has_stamps:
            if order == "time" or relations is not None:
                what = "the log has lost its times, order=time and relations need them"
                raise ConfigError(f"{path}: {what}")
            stamps = np.asarray(NOMINAL_STEP * np.arange(len(stamps)), np.float64)

        kept = np.argsort(stamps, kind="stable") if order == "time" else np.arange(len(stamps))
        kept = kept[::stride]
        if min_distance > 0 or min_angle_deg > 0:
            if odometry is None:
                raise ConfigError(f"{path}: no odometry, min_distance and min_angle_deg need it")
            kept = kept[moved(odometry[kept], min_distance, np.deg2rad(min_angle_deg))]
        kept = kept[:max_scans]

        self.max_range = no_return_limit(log) if max_range is None else float(max_range)
        self._min_range = min_range
        self._ranges, self._kept = log.ranges, kept
        beams = log.ranges.beams
        first, spacing = BEAM_ANGLES_DEG[beams]
        self.angles: Array = np.asarray(np.deg2rad(first + spacing * np.arange(beams)), np.float64)
        self.stamps = stamps[kept]
        self.odometry = None if odometry is None else planar_poses(odometry[kept])
        self.ground_truth = None if ground_truth is None else planar_poses(ground_truth[kept])

        listed = b"" if relations is None else read_bytes(relations)
        self._relations = None if relations is None else parse_relations(relations, listed)
        settings = [VERSION, self.corrected, self.max_range, float(min_range), stride]
        settings += [float(min_distance), float(min_angle_deg), max_scans, order, on_error]
        determined_by = [content.hexdigest(), hashlib.sha256(listed).hexdigest()]
        self._fingerprint = hashlib.sha256(repr(determined_by + settings).encode()).hexdigest()

    def __len__(self) -> int:
        return len(self._kept)

    def __getitem__(self, index: int) -> Scan:
        if not 0 <= index < len(self):
            raise IndexError(f"scan {index} of {len(self)}")
        ranges = self.readings(index)
        return Scan(
            index=index,
            stamp=float(self.stamps[index]),
            points=beam_points(ranges, self.angles),
            planar=True,
            ranges=ranges,
            angles=self.angles,
            odometry=None if self.odometry is None else self.odometry[index],
            ground_truth=None if self.ground_truth is None else self.ground_truth[index],
        )

    @property
    def ranges(self) -> Array:
        """The readings (S, B) of all scans; made anew each time, read from disk."""
        return np.stack([self.readings(index) for index in range(len(self))])

    def readings(self, index: int) -> Array:
        """The readings (B,) of scan ``index`` in m, NaN for no return."""
        readings = self._ranges[int(self._kept[index])]
        returned = (readings > self._min_range) & (readings < self.max_range)
        readings[~returned] = np.nan
        return readings

    def fingerprint(self) -> str:
        """sha256 of the unpacked log, the relations and the settings, wherever the files are."""
        return self._fingerprint

    @property
    def relations(self) -> Relations | None:
        """The relations of the relations file, or None."""
        return self._relations


def is_corrected(log: CarmenLog) -> bool:
    """True if the FLASER poses are not the odometry of the ODOM lines before them.

    Both triples must differ: with a laser off the robot's centre the first one alone does.
    """
    before = log.odom_before[log.good] - 1
    known = before >= 0
    if not known.any():
        return False
    odom = log.odom[before[known]]
    differ = _apart(log.laser_poses[known], odom) & _apart(log.robot_poses[known], odom)
    return bool(differ.mean() > 0.5)


def _apart(poses: Array, others: Array) -> NDArray[np.bool_]:
    shift = np.linalg.norm((poses - others)[:, :2], axis=1)
    turn = np.abs(wrap(poses[:, 2] - others[:, 2]))
    return np.asarray((shift > POSE_TOLERANCE_M) | (turn > np.deg2rad(POSE_TOLERANCE_DEG)))


def _poses(path: str, log: CarmenLog, corrected: bool) -> tuple[Array | None, Array | None]:
    """Odometry and ground truth (S, 3) each, or None."""
    if not corrected:
        return log.laser_poses, None
    missing = np.flatnonzero(log.odom_before[log.good] == 0)
    if len(missing):
        raise DataError.at(
            path,
            int(log.lines[missing[0]]),
            "FLASER",
            "an ODOM line before it: a corrected log takes its odometry from that "
            "(corrected=False if the poses of this log are the odometry)",
        )
    if not _odom_follows_correction(log):
        return log.odom[log.odom_before[log.good] - 1], log.laser_poses
    return _odometry_between_scans(log), log.laser_poses


def _odom_follows_correction(log: CarmenLog) -> bool:
    """True if the ODOM line after a scan mostly is a copy of that scan's corrected pose."""
    after = log.odom_before[log.good]
    known = after < len(log.odom)
    if not known.any():
        return False
    offset = log.odom[after[known]] - log.laser_poses[known]
    offset[:, 2] = wrap(offset[:, 2])
    return bool(np.mean(np.abs(offset).max(axis=1) < RESET_TOLERANCE) > 0.5)


def _odometry_between_scans(log: CarmenLog) -> Array | None:
    """Odometry (S, 3) summed up from the ODOM lines between scans, without the jumps at scans.

    None if most scans have less than two ODOM lines between them: the one is the jump itself.
    """
    lines_between = np.diff(log.odom_before)
    if len(lines_between) and np.mean(lines_between < 2) > 0.5:
        return None
    last = log.odom_before[1:] - 1
    first = np.minimum(log.odom_before[:-1], last)
    poses = planar_poses(log.odom)
    steps = inverse(poses[first]) @ poses[last]
    summed = [poses[log.odom_before[0] - 1]]
    for step in steps:
        summed.append(summed[-1] @ step)
    T = np.stack(summed)[log.good]
    return np.column_stack([T[:, 0, 3], T[:, 1, 3], np.arctan2(T[:, 1, 0], T[:, 0, 0])])


def no_return_limit(log: CarmenLog) -> float:
    """The range in m from which on a reading means "no return"; infinity if none does."""
    limit = np.inf if log.sensor_max is None else log.sensor_max
    readings = log.ranges
    if readings.longest_count >= max(NO_RETURN_READINGS, NO_RETURN_SHARE * readings.finite_count):
        limit = min(limit, readings.longest - NO_RETURN_BAND)
    return float(limit)


def moved(poses: Array, distance: float, angle: float) -> NDArray[np.int64]:
    """Indices of the poses (S, 3) to keep: the first, and each that moved far enough from the last.

    Far enough is ``distance`` (m) or ``angle`` (rad), whichever comes first; 0 turns one off.
    """
    distance, angle = distance or np.inf, angle or np.inf
    kept = [0]
    x, y, theta = poses[0]
    for index, (px, py, ptheta) in enumerate(poses):
        far = np.hypot(px - x, py - y) >= distance
        if far or abs((ptheta - theta + np.pi) % (2 * np.pi) - np.pi) >= angle:
            kept.append(index)
            x, y, theta = px, py, ptheta
    return np.array(kept)


def wrap(angle: Array) -> Array:
    """Angles (rad) in [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def planar_poses(poses: Array) -> Array:
    """4x4 poses (S, 4, 4) of planar poses (S, 3): x, y in m and theta in rad."""
    T = np.tile(np.eye(4), (len(poses), 1, 1))
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    T[:, 0, 0], T[:, 0, 1], T[:, 1, 0], T[:, 1, 1] = c, -s, s, c
    T[:, :2, 3] = poses[:, :2]
    return T
