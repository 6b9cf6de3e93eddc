"""Parse CARMEN logs (.log, .clf) and relations files into arrays.

A line of interest is one of

    FLASER n r_1..r_n x y theta odom_x odom_y odom_theta ipc_timestamp host logger_timestamp
    ODOM x y theta tv rv accel ipc_timestamp host logger_timestamp
    PARAM name value ...

and everything else is left alone.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.base import Relations
from rbtm_bench.datasets.files import data_lines, quoted, to_numbers

BEAM_ANGLES_DEG: dict[int, tuple[float, float]] = {
    180: (-90.0, 1.0),
    181: (-90.0, 1.0),
    360: (-90.0, 0.5),
    361: (-90.0, 0.5),
}
"""First angle and spacing (deg) of the laser set-ups known by their number of readings."""

KNOWN_COUNTS = ", ".join(map(str, BEAM_ANGLES_DEG))
_COUNTS = {str(count).encode(): count for count in BEAM_ANGLES_DEG}
TAIL_WORDS = 9
ODOM_WORDS = 10
SENSOR_MAX_PARAM = "robot_front_laser_max"


@dataclass(frozen=True, eq=False)
class CarmenLog:
    """The FLASER lines of a log (S of them, in file order) and the ODOM lines around them.

    ``ranges`` the readings (B,) of each scan, m as written; ``laser_poses`` and ``robot_poses``
    (S, 3) the two pose triples (x, y, theta; m, rad); ``stamps`` (S,) s the ipc_timestamp;
    ``lines`` (S,) line numbers. ``odom`` (O, 3) holds the poses of the ODOM lines.
    ``odom_before`` (F,) says how many of them precede each FLASER line, malformed ones included,
    and ``good`` (S,) which of those F lines the S scans are. ``sensor_max`` (m) is the log's own
    PARAM, if it has one. ``skipped`` counts malformed lines that were left out.
    """

    ranges: RangeFile
    laser_poses: Array
    robot_poses: Array
    stamps: Array
    lines: NDArray[np.int64]
    odom: Array
    odom_before: NDArray[np.int64]
    good: NDArray[np.int64]
    sensor_max: float | None
    skipped: int


class RangeFile:
    """The readings of a log's scans, in a temporary file: memory does not grow with the log.

    ``longest`` is the longest finite reading (m), ``longest_count`` how often it occurs among
    ``finite_count`` finite ones.
    """

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(prefix="rbtm_bench-")  # noqa: SIM115 (kept open)
        self.beams = 0
        self.count = 0
        self.longest, self.longest_count, self.finite_count = -math.inf, 0, 0

    def __len__(self) -> int:
        return self.count

    def append(self, readings: list[float]) -> None:
        """Add a scan's readings (B,)."""
        row = np.array(readings)
        self._file.write(row.tobytes())
        self.beams, self.count = len(row), self.count + 1
        finite = row[np.isfinite(row)]
        self.finite_count += len(finite)
        if len(finite) == 0:
            return
        longest = float(finite.max())
        if longest > self.longest:
            self.longest, self.longest_count = longest, 0
        if longest == self.longest:
            self.longest_count += int(np.count_nonzero(finite == longest))

    def __getitem__(self, scan: int) -> Array:
        """The readings (B,) of a scan, in order of the file; an array of the caller's own."""
        size = 8 * self.beams
        if self._file.writable():
            self._file.flush()
        return np.frombuffer(os.pread(self._file.fileno(), size, size * scan)).copy()


def parse_log(path: str, lines: Iterable[bytes], on_error: Literal["raise", "skip"]) -> CarmenLog:
    """Parse the lines of a log; ``path`` only serves the messages.

    Raises ``DataError`` with file, line and field for the first malformed line, unless
    ``on_error`` is "skip"; and always if no FLASER line can be used.
    """
    reader = _Reader(path)
    for number, line in enumerate(lines, start=1):
        if b"\0" in line:
            raise DataError(f"{path}: not a CARMEN log (binary data)")
        words = line.split()
        if not words:
            continue
        try:
            reader.read(number, words)
        except DataError as error:
            if on_error == "raise":
                raise
            reader.note(error)
    return reader.log()


class _Reader:
    """Collects the lines of one log."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.count: int | None = None
        self.ranges = RangeFile()
        self.tails: list[list[float]] = []
        self.lines: list[int] = []
        self.odom: list[list[float]] = []
        self.odom_before: list[int] = []
        self.good: list[int] = []
        self.sensor_max: float | None = None
        self.skipped = 0
        self.first_error: DataError | None = None

    def read(self, number: int, words: list[bytes]) -> None:
        keyword = words[0]
        if keyword == b"FLASER":
            self.odom_before.append(len(self.odom))
            self._read_flaser(number, words)
        elif keyword == b"ODOM":
            self.odom.append(self._read_odom(number, words))
        elif keyword == b"PARAM" and len(words) > 2 and words[1] == SENSOR_MAX_PARAM.encode():
            self.sensor_max = self._numbers(number, SENSOR_MAX_PARAM, words[2:3])[0]

    def note(self, error: DataError) -> None:
        self.skipped += 1
        self.first_error = self.first_error or error

    def _read_flaser(self, number: int, words: list[bytes]) -> None:
        count = self._count(number, words)
        expected = 2 + count + TAIL_WORDS
        if len(words) != expected:
            raise DataError.at(
                self.path,
                number,
                "FLASER",
                f"{expected} words for {count} readings, {len(words)} found",
            )
        ranges = self._numbers(number, "range", words[2 : 2 + count], finite=False)
        tail = self._numbers(number, "pose", words[2 + count : 8 + count])
        tail += self._numbers(number, "ipc_timestamp", words[8 + count : 9 + count])
        self.count = count
        self.ranges.append(ranges)
        self.tails.append(tail)
        self.lines.append(number)
        self.good.append(len(self.odom_before) - 1)

    def _count(self, number: int, words: list[bytes]) -> int:
        word = words[1] if len(words) > 1 else b""
        count = _COUNTS.get(word)
        if count is None:
            raise DataError.at(
                self.path, number, "number of readings", f"one of {KNOWN_COUNTS}, {quoted(word)}"
            )
        if self.count is not None and count != self.count:
            raise DataError.at(
                self.path, number, "number of readings", f"{self.count} as before, {quoted(word)}"
            )
        return count

    def _read_odom(self, number: int, words: list[bytes]) -> list[float]:
        if len(words) != ODOM_WORDS:
            raise DataError.at(self.path, number, "ODOM", f"{ODOM_WORDS} words, {len(words)} found")
        return self._numbers(number, "pose", words[1:4])

    def _numbers(
        self, number: int, field: str, words: list[bytes], finite: bool = True
    ) -> list[float]:
        return to_numbers(self.path, number, field, words, finite)

    def log(self) -> CarmenLog:
        if len(self.ranges) == 0:
            if self.first_error is None:
                raise DataError(f"{self.path}: not a CARMEN log (no FLASER line)")
            raise DataError(
                f"{self.path}: no usable FLASER line, {self.skipped} malformed; "
                f"the first: {self.first_error}"
            )
        tails = np.array(self.tails)
        return CarmenLog(
            ranges=self.ranges,
            laser_poses=tails[:, :3],
            robot_poses=tails[:, 3:6],
            stamps=tails[:, 6],
            lines=np.array(self.lines),
            odom=np.array(self.odom).reshape(-1, 3),
            odom_before=np.array(self.odom_before),
            good=np.array(self.good),
            sensor_max=self.sensor_max,
            skipped=self.skipped,
        )


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
        rows.append(to_numbers(path, number, "relation", words))
    if not rows:
        raise DataError(f"{path}: no relation in the file")
    table = np.array(rows)
    T_start_end = np.tile(np.eye(4), (len(table), 1, 1))
    T_start_end[:, :3, :3] = Rotation.from_euler("ZYX", table[:, [7, 6, 5]]).as_matrix()
    T_start_end[:, :3, 3] = table[:, 2:5]
    return Relations(start=table[:, 0], end=table[:, 1], T_start_end=T_start_end)
