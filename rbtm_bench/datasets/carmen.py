"""Robot logs in the CARMEN format: a planar laser, wheel odometry, perhaps a corrected path."""

from __future__ import annotations

import hashlib
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.association import nearest, span, time_suspicions
from rbtm_bench.datasets.base import Dataset, Drops, Reading, Relations, beam_points
from rbtm_bench.datasets.carmen_doubts import drifts, motion_doubts, relation_doubts
from rbtm_bench.datasets.carmen_log import CarmenLog, parse_log, parse_relations
from rbtm_bench.datasets.carmen_roles import UNTOLD, Roles, find_roles
from rbtm_bench.datasets.carmen_sensor import (
    FARTHEST_READING,
    far_doubt,
    find_angles,
    find_scale,
    near_limit,
    no_return_limit,
)
from rbtm_bench.datasets.files import read_bytes, reader, unpacked_lines
from rbtm_bench.datasets.planar import moved, planar_poses

VERSION = "carmen-1"
"""Part of the fingerprint: change it whenever the same file and settings give other scans."""

NOMINAL_STEP = 0.1
"""s between scans of a log that has lost its times."""

RELATION_TOLERANCE = 1e-4
"""s; the relation error's own."""

Kind = Literal["auto", "FLASER", "ROBOTLASER1", "RAWLASER1", "RLASER", "ROBOTLASER2", "RAWLASER2"]


class Carmen(Dataset):
    """The scans of a CARMEN log (plain, gzip or bzip2, recognised by content).

    **Lines.** ``message`` names the kind of lines (FLASER, ROBOTLASER1, RAWLASER1, RLASER, ...)
    that the scans are taken from; "auto" takes the first of these that the log has.

    **Poses.** A raw log repeats its odometry in the lines of its scans. A corrected log holds a
    corrected path there: that is ``ground_truth``, never odometry. ``corrected`` says which it is;
    "auto" finds out (``carmen_roles``) and refuses a log that could be either. A corrected log
    takes its odometry from the ODOM lines (or its second triple); where these jump to the
    corrected pose after every scan (as in the Radish collection), the jumps are left out, else the
    odometry would never drift. A log with nothing but those jumps has no odometry at all.

    **Readings** are metres; ``scale`` m a unit says otherwise. A range is no return if it is NaN
    or infinite, at most ``min_range`` (m), or at least ``max_range`` (m). ``max_range`` None finds
    out (``carmen_sensor``). ``angles`` (first, spacing) in deg are those of the beams; None finds
    out from the message, PARAM lines and the number of beams.

    **Order and thinning**, in this sequence: ``order`` (file, or time by stamp), every
    ``stride``-th scan, scans that moved ``min_distance`` (m) or turned ``min_angle_deg`` since the
    last one kept, judged by odometry (0 turns a criterion off), at most ``max_scans``.

    Stamps are the ipc_timestamp (s). If at most half of them are distinct, the log has lost its
    times: stamps are then 0.1 s apart, ``has_stamps`` is False and ``suspicions`` say so.

    ``relations`` is a file of reference relations, of which some must belong to scans of the log;
    ``on_error`` "skip" leaves malformed lines out and counts them in ``skipped``. Raises
    ``DataError`` for files that cannot be read, parsed or told, ``ConfigError`` for settings that
    this log cannot meet.
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
        angles: tuple[float, float] | None = None,
        scale: Literal["auto"] | Annotated[float, Gt(0)] = "auto",
        message: Kind = "auto",
        stride: Annotated[int, Ge(1)] = 1,
        min_distance: Annotated[float, Ge(0)] = 0.0,
        min_angle_deg: Annotated[float, Ge(0)] = 0.0,
        max_scans: Annotated[int, Ge(1)] | None = None,
        order: Literal["file", "time"] = "file",
        on_error: Literal["raise", "skip"] = "raise",
    ) -> None:
        log, content, roles = _opened(path, on_error, message, corrected)
        self.skipped, self.corrected = log.skipped, roles.corrected
        self.has_odometry = roles.odometry is not None
        self.has_ground_truth = roles.truth is not None
        self.has_stamps = 2 * len(np.unique(log.stamps)) > len(log.stamps)
        stamps = log.stamps if self.has_stamps else _nominal(path, log, order, relations)
        kept = _kept(path, stamps, roles.odometry, order, stride, min_distance, min_angle_deg)
        self._kept = kept[:max_scans]
        self._min_range, self._ranges = float(min_range), log.ranges
        self._sensor(path, log, scale, max_range, angles)
        self._drops = Drops()
        self.stamps: Array = stamps[self._kept]
        self.odometry = None if roles.odometry is None else planar_poses(roles.odometry[self._kept])
        self.ground_truth = None if roles.truth is None else planar_poses(roles.truth[self._kept])

        listed = b"" if relations is None else read_bytes(relations)
        self._relations = None if relations is None else parse_relations(relations, listed)
        self.readings += roles.readings
        self.suspicions += (*roles.suspicions, *time_suspicions(log.stamps))
        for poses in (roles.odometry, roles.truth):
            if poses is not None:
                self.suspicions += motion_doubts(poses, log.stamps if self.has_stamps else None)
        if not self.has_stamps:
            self.suspicions += (f"the log has lost its times: {NOMINAL_STEP} s a scan are assumed",)
        if relations is not None and self._relations is not None:
            self.readings += (_matched(relations, self._relations, log.stamps),)
            told = (self._relations, log.stamps, roles.odometry, RELATION_TOLERANCE)
            self.suspicions += relation_doubts(*told)
            if UNTOLD in self.suspicions and drifts(*told):
                self.suspicions = tuple(text for text in self.suspicions if text != UNTOLD)
        settings = [VERSION, self.corrected, self.max_range, self._min_range, stride]
        settings += [float(min_distance), float(min_angle_deg), max_scans, order, on_error]
        settings += _unusual(log, self.angles, self.scale)
        determined_by = [content, hashlib.sha256(listed).hexdigest()]
        self._fingerprint = hashlib.sha256(repr(determined_by + settings).encode()).hexdigest()

    def _sensor(
        self,
        path: str,
        log: CarmenLog,
        scale: Literal["auto"] | float,
        max_range: float | None,
        angles: tuple[float, float] | None,
    ) -> None:
        """Unit, no returns and angles of the readings."""
        sample = log.ranges.sample()
        self.scale = find_scale(path, sample, scale)
        limit, why = no_return_limit(log, sample, self.scale)
        if max_range is not None:
            limit, why = float(max_range), "as asked for"
        self.max_range = limit
        near, count = near_limit(self.scale * sample) if self._min_range == 0.0 else (0.0, 0)
        self._min_range = max(self._min_range, near)
        beams = find_angles(path, log, sample, angles)
        self.angles: Array = beams.angles
        taken = "none" if np.isinf(limit) else f"from {limit:g} m on"
        others = ", ".join(f"{count} {name}" for name, count in log.others.items())
        kind = f"{len(log.stamps)} {log.message} lines"
        self.readings = (
            Reading(
                "lines", kind, f"beside {others}" if others else "", "message" if others else ""
            ),
            Reading("no return", taken, why, "max_range"),
            beams.reading,
        )
        if near:
            why = f"{count} readings are {near:g} m, all alone"
            self.readings += (Reading("no return", f"up to {near:g} m", why, "min_range"),)
        if self.scale != 1.0:
            self.readings += (Reading("unit", f"{self.scale:g} m", "as asked for", "scale"),)
        self.suspicions = beams.suspicions
        if max_range is None:
            self.suspicions += far_doubt(self.scale * sample, limit)

    def __len__(self) -> int:
        return len(self._kept)

    def __getitem__(self, index: int) -> Scan:
        if not 0 <= index < len(self):
            raise IndexError(f"scan {index} of {len(self)}")
        ranges = self.beams(index)
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
        return np.stack([self.beams(index) for index in range(len(self))])

    def beams(self, index: int) -> Array:
        """The readings (B,) of scan ``index`` in m, NaN for no return."""
        readings = self._ranges[int(self._kept[index])]
        if self.scale != 1.0:
            readings *= self.scale
        finite = np.isfinite(readings)
        near, far = finite & (readings <= self._min_range), finite & (readings >= self.max_range)
        absurd = finite & ~near & ~far & (np.abs(readings) > FARTHEST_READING)
        self._drops.note(
            index,
            not_finite=(~finite).sum(),
            too_near=near.sum(),
            no_return=far.sum(),
            beyond_10_km=absurd.sum(),
        )
        readings[~finite | near | far | absurd] = np.nan
        return readings

    def dropped(self) -> dict[str, int]:
        return self._drops.total()

    def fingerprint(self) -> str:
        """sha256 of the unpacked log, the relations and the settings, wherever the files are."""
        return self._fingerprint

    @property
    def relations(self) -> Relations | None:
        """The relations of the relations file, or None."""
        return self._relations


@reader
def _opened(
    path: str, on_error: Literal["raise", "skip"], message: str, corrected: Literal["auto"] | bool
) -> tuple[CarmenLog, str, Roles]:
    """The log, the digest of its content, and the roles of its poses."""
    content = hashlib.sha256()
    log = parse_log(path, unpacked_lines(path, content), on_error, message)
    return log, content.hexdigest(), find_roles(path, log, corrected)


def _nominal(path: str, log: CarmenLog, order: str, relations: str | None) -> Array:
    if order == "time" or relations is not None:
        what = "the log has lost its times, order=time and relations need them"
        raise ConfigError(f"{path}: {what}")
    return np.asarray(NOMINAL_STEP * np.arange(len(log.stamps)), np.float64)


def _kept(
    path: str,
    stamps: Array,
    odometry: Array | None,
    order: str,
    stride: int,
    min_distance: float,
    min_angle_deg: float,
) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """Which scans of the log are used, in order."""
    kept = np.argsort(stamps, kind="stable") if order == "time" else np.arange(len(stamps))
    kept = kept[::stride]
    if min_distance > 0 or min_angle_deg > 0:
        if odometry is None:
            raise ConfigError(f"{path}: no odometry, min_distance and min_angle_deg need it")
        kept = kept[moved(odometry[kept], min_distance, np.deg2rad(min_angle_deg))]
    return kept


def _matched(path: str, relations: Relations, stamps: Array) -> Reading:
    """How many relations belong to scans of the log. Raises ``DataError`` if none does."""
    ends = [nearest(stamps, t, RELATION_TOLERANCE) >= 0 for t in (relations.start, relations.end)]
    count = int(np.count_nonzero(ends[0] & ends[1]))
    if count == 0:
        times = np.concatenate([relations.start, relations.end])
        raise DataError(
            f"{path}: none of {len(relations)} relations lies within {RELATION_TOLERANCE:g} s of "
            f"scans: they are from {span(times)}, the scans from {span(stamps)}"
        )
    taken = f"{count} of {len(relations)} between scans"
    return Reading("relations", taken, f"both ends within {RELATION_TOLERANCE:g} s", "")


def _unusual(log: CarmenLog, angles: Array, scale: float) -> list[object]:
    """What else determines the scans, where it is not what it is in most logs."""
    beams = len(angles)
    usual = {180: (-90.0, 1.0), 181: (-90.0, 1.0), 360: (-90.0, 0.5), 361: (-90.0, 0.5)}
    first, spacing = usual.get(beams, (0.0, 0.0))
    same = np.array_equal(angles, np.deg2rad(first + spacing * np.arange(beams)))
    if same and scale == 1.0 and log.message == "FLASER":
        return []
    return [log.message, scale, angles.tobytes().hex()]
