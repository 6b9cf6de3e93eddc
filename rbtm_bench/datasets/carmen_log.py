"""Parse CARMEN logs (.log, .clf) and relations files into arrays; ``carmen_messages`` are the
lines of interest, everything else is left alone."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.base import Relations
from rbtm_bench.datasets.carmen_messages import (
    FARTHEST,
    LASERS,
    Laser,
    Line,
    Message,
    read_laser,
    read_odom,
)
from rbtm_bench.datasets.files import data_lines, quoted, to_numbers

SAMPLE = 1 << 22
"""Readings that are looked at to find out what a value means."""

SWITCH = {"on": 1.0, "true": 1.0, "yes": 1.0, "off": 0.0, "false": 0.0, "no": 0.0}

_LASERS = {name.encode(): name for name in LASERS}


@dataclass(frozen=True, eq=False)
class CarmenLog:
    """The scans of one laser of a log (S of them, in file order) and the ODOM lines around them.

    ``message`` the kind of line, ``laser`` what it says of the laser, if anything; ``ranges`` the
    readings (B,) of each scan as written; ``laser_poses`` and ``robot_poses`` (S, 3) its two pose
    triples (x, y, theta; m, rad), or None; ``stamps`` (S,) s the ipc_timestamp; ``lines`` (S,)
    line numbers. ``odom`` (O, 3) and ``odom_stamps`` (O,) hold the ODOM lines. ``odom_before``
    (F,) says how many of them precede each scan's line, malformed ones included, and ``good``
    (S,) which of those F lines the S scans are. ``params`` are the PARAM lines that tell of
    lasers. ``others`` counts the lines of other lasers, ``words`` those of other kinds.
    ``skipped`` counts malformed lines that were left out.
    """

    message: str
    laser: Laser | None
    ranges: RangeFile
    laser_poses: Array | None
    robot_poses: Array | None
    stamps: Array
    lines: NDArray[np.int64]
    odom: Array
    odom_stamps: Array
    odom_before: NDArray[np.int64]
    good: NDArray[np.int64]
    params: dict[str, str]
    others: dict[str, int]
    words: dict[str, int]
    skipped: int

    def param(self, *names: str) -> float | None:
        """The first of these PARAMs that is set to a number, or to on or off."""
        for name in names:
            value = self.params.get(name, "")
            try:
                return SWITCH.get(value.lower()) if value.lower() in SWITCH else float(value)
            except ValueError:
                continue
        return None

    def laser_param(self, setting: str, rear: bool = False) -> float | None:
        """A PARAM of the front (or rear) laser by CARMEN's old or newer name."""
        side, number = ("rear", 2) if rear else ("front", 1)
        places = (f"laser_{side}_laser", f"laser_laser{number}", f"laser{number}")
        return self.param(*(f"{place}_{setting}" for place in places))


class RangeFile:
    """The readings of a log's scans, in a temporary file: memory does not grow with the log."""

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(prefix="rbtm_bench-")  # noqa: SIM115 (kept open)
        self.beams = 0
        self.count = 0

    def __len__(self) -> int:
        return self.count

    def append(self, readings: list[float]) -> None:
        """Add a scan's readings (B,)."""
        self._file.write(np.array(readings).tobytes())
        self.beams, self.count = len(readings), self.count + 1

    def __getitem__(self, scan: int) -> Array:
        """The readings (B,) of a scan, in order of the file; an array of the caller's own."""
        size = 8 * self.beams
        if self._file.writable():
            self._file.flush()
        return np.frombuffer(os.pread(self._file.fileno(), size, size * scan)).copy()

    def sample(self) -> Array:
        """The readings (K, B) of all scans, or of as many, evenly spread, as are enough."""
        stride = -(-self.count * self.beams // SAMPLE)
        return np.stack([self[scan] for scan in range(0, self.count, stride)])


@dataclass
class _Table:
    """The scans of one kind of message while they are collected."""

    ranges: RangeFile = field(default_factory=RangeFile)
    laser: Laser | None = None
    poses: list[list[float]] = field(default_factory=list)
    stamps: list[float] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)
    odom_before: list[int] = field(default_factory=list)
    good: list[int] = field(default_factory=list)


def parse_log(
    path: str,
    lines: Iterable[bytes],
    on_error: Literal["raise", "skip"],
    message: str = "auto",
) -> CarmenLog:
    """Parse the lines of a log; ``path`` only serves the messages.

    ``message`` is the kind of lines to take the scans from, "auto" for the one to be preferred of
    those that there are. Raises ``DataError`` with file, line and field for the first malformed
    line, unless ``on_error`` is "skip"; and always if no line with readings can be used.
    """
    collector = _Collector(path)
    for number, line in enumerate(lines, start=1):
        if b"\0" in line:
            raise DataError(f"{path}: not a CARMEN log (binary data)")
        words = line.split()
        if not words:
            continue
        try:
            collector.read(Line(path, number, words))
        except DataError as error:
            if on_error == "raise":
                raise
            collector.note(error)
    return collector.log(message)


class _Collector:
    """Collects the lines of one log."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.tables: dict[str, _Table] = {}
        self.odom: list[list[float]] = []
        self.params: dict[str, str] = {}
        self.words: dict[str, int] = {}
        self.skipped = 0
        self.first_error: DataError | None = None

    def read(self, line: Line) -> None:
        keyword = line.words[0]
        if keyword in _LASERS:
            self._add(line, self.tables.setdefault(_LASERS[keyword], _Table()))
        elif keyword == b"ODOM":
            self.odom.append(read_odom(line))
        elif keyword == b"PARAM" and len(line.words) > 2 and b"laser" in line.words[1]:
            self._set(line)
        elif keyword.isalpha():
            word = keyword[:20].decode("latin-1")
            if word in self.words or len(self.words) < 100:
                self.words[word] = self.words.get(word, 0) + 1

    def _set(self, line: Line) -> None:
        name = line.words[1].decode("latin-1")
        if name == SENSOR_MAX_PARAM:
            line.numbers(name, 2, 1)
        self.params[name] = line.words[2].decode("latin-1")

    def note(self, error: DataError) -> None:
        self.skipped += 1
        self.first_error = self.first_error or error

    def _add(self, line: Line, table: _Table) -> None:
        table.odom_before.append(len(self.odom))
        scan: Message = read_laser(line)
        beams = table.ranges.beams
        if beams and len(scan.ranges) != beams:
            found = quoted(str(len(scan.ranges)).encode())
            raise line.wrong("number of readings", f"{beams} as before, {found}")
        if table.laser is not None and table.laser != scan.laser:
            raise line.wrong("laser", f"the settings of the scans before, {table.laser}")
        table.laser = scan.laser
        table.ranges.append(scan.ranges)
        if scan.poses is not None:
            table.poses.append(scan.poses)
        table.stamps.append(scan.stamp)
        table.lines.append(line.number)
        table.good.append(len(table.odom_before) - 1)

    def log(self, message: str) -> CarmenLog:
        usable = [name for name in LASERS if name in self.tables and self.tables[name].stamps]
        if not usable:
            if self.first_error is None:
                others = ", ".join(LASERS[1:3])
                raise DataError(f"{self.path}: not a CARMEN log (no FLASER line, nor {others})")
            raise DataError(
                f"{self.path}: no usable line with readings, {self.skipped} malformed; "
                f"the first: {self.first_error}"
            )
        if message != "auto" and message not in usable:
            raise ConfigError(f"{self.path}: no {message} line, there are {', '.join(usable)}")
        name = usable[0] if message == "auto" else message
        table = self.tables[name]
        poses = np.array(table.poses) if table.poses else None
        odom = np.array(self.odom).reshape(-1, 4)
        return CarmenLog(
            message=name,
            laser=table.laser,
            ranges=table.ranges,
            laser_poses=None if poses is None else poses[:, :3],
            robot_poses=None if poses is None else poses[:, 3:6],
            stamps=np.array(table.stamps),
            lines=np.array(table.lines),
            odom=odom[:, :3],
            odom_stamps=odom[:, 3],
            odom_before=np.array(table.odom_before),
            good=np.array(table.good),
            params=self.params,
            others={other: len(self.tables[other].stamps) for other in usable if other != name},
            words=self.words,
            skipped=self.skipped,
        )


SENSOR_MAX_PARAM = "robot_front_laser_max"


def parse_relations(path: str, content: bytes) -> Relations:
    """Parse lines ``t1 t2 x y z roll pitch yaw`` (s, m, rad; R = Rz(yaw) Ry(pitch) Rx(roll)).

    Blank lines and lines that start with # are left out. Raises ``DataError`` with file and line.
    """
    from scipy.spatial.transform import Rotation

    rows: list[list[float]] = []
    for number, words in data_lines(content):
        if len(words) != 8:
            expected = "8 numbers t1 t2 x y z roll pitch yaw"
            raise DataError.at(path, number, "relation", f"{expected}, {len(words)} words found")
        times = to_numbers(path, number, "relation", words[:2])
        rows.append(times + to_numbers(path, number, "relation", words[2:], largest=FARTHEST))
    if not rows:
        raise DataError(f"{path}: no relation in the file")
    table = np.array(rows)
    largest = float(np.abs(table[:, 5:]).max())
    if largest > 2 * np.pi + 0.01:
        raise DataError(f"{path}: angles up to {largest:.4g}: expected rad, degrees found?")
    T_start_end = np.tile(np.eye(4), (len(table), 1, 1))
    T_start_end[:, :3, :3] = Rotation.from_euler("ZYX", table[:, [7, 6, 5]]).as_matrix()
    T_start_end[:, :3, 3] = table[:, 2:5]
    return Relations(start=table[:, 0], end=table[:, 1], T_start_end=T_start_end)
