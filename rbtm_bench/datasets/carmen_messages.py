"""The lines of a CARMEN log, a message each, word by word.

    FLASER n r_1..r_n x y theta odom_x odom_y odom_theta ipc_timestamp host logger_timestamp
    ROBOTLASER1 type start fov resolution max accuracy remission n r_1..r_n m e_1..e_m
        laser_x laser_y laser_theta x y theta tv rv forward side turn_axis ipc_timestamp host time
    RAWLASER1 type start fov resolution max accuracy remission n r_1..r_n m e_1..e_m
        ipc_timestamp host logger_timestamp
    ODOM x y theta tv rv accel ipc_timestamp host logger_timestamp
    PARAM name value ...

RLASER is FLASER's rear twin, ROBOTLASER2 and RAWLASER2 are those of a second laser.
"""

from __future__ import annotations

from dataclasses import dataclass

from rbtm_bench.core.errors import DataError
from rbtm_bench.datasets.files import quoted, to_numbers

LASERS = ("FLASER", "ROBOTLASER1", "RAWLASER1", "RLASER", "ROBOTLASER2", "RAWLASER2")
"""Messages with readings, the one to be preferred first."""

MOST_READINGS = 100_000
FARTHEST = 1e7
"""m (and rad) at most in a pose: farther is not on Earth."""

_POSES, _STAMPS = 6, 3
_HEAD_WORDS = 9
"""Of a message that describes its laser: keyword, seven settings, number of readings."""


@dataclass(frozen=True)
class Laser:
    """What a message says of its laser: first angle, field of view and spacing in rad, and the
    maximum range in m."""

    start: float
    fov: float
    resolution: float
    max_range: float


@dataclass(frozen=True)
class Message:
    """One scan: readings in m, laser and robot pose (x, y, theta; m, rad) if given, time in s."""

    ranges: list[float]
    poses: list[float] | None
    stamp: float
    laser: Laser | None = None


@dataclass(frozen=True)
class Line:
    """A line of a file: where it stands, and its words."""

    path: str
    number: int
    words: list[bytes]

    def numbers(
        self, field: str, first: int, count: int, finite: bool = True, largest: float = FARTHEST
    ) -> list[float]:
        """``count`` words from ``first`` on as numbers."""
        words = self.words[first : first + count]
        return to_numbers(self.path, self.number, field, words, finite, largest)

    def stamp(self, at: int) -> float:
        """The word ``at`` as a time in s."""
        return self.numbers("ipc_timestamp", at, 1, largest=1e12)[0]

    def wrong(self, field: str, expected: str) -> DataError:
        """The error that says so."""
        return DataError.at(self.path, self.number, field, expected)

    def count(self, at: int, what: str = "number of readings", least: int = 1) -> int:
        """The word ``at`` as a count, held against the words that there are."""
        word = self.words[at] if len(self.words) > at else b""
        if not word.isdigit() or not least <= int(word[:9]) <= MOST_READINGS:
            raise self.wrong(what, f"a count from {least} on, {quoted(word)}")
        return int(word)

    def has(self, expected: int, what: str) -> None:
        """Refuse a line of another length."""
        if len(self.words) != expected:
            name = self.words[0].decode("ascii", "replace")
            raise self.wrong(name, f"{expected} words{what}, {len(self.words)} found")


def read_laser(line: Line) -> Message:
    """A line with readings. Raises ``DataError`` where it is malformed."""
    keyword = line.words[0]
    if keyword in (b"FLASER", b"RLASER"):
        count = line.count(1)
        line.has(2 + count + _POSES + _STAMPS, f" for {count} readings")
        poses = line.numbers("pose", 2 + count, _POSES)
        ranges = line.numbers("range", 2, count, finite=False)
        return Message(ranges, poses, line.stamp(2 + count + _POSES))
    count = line.count(_HEAD_WORDS - 1)
    after = _HEAD_WORDS + count
    remissions = line.count(after, "number of remissions", least=0)
    after += 1 + remissions
    moving = keyword.startswith(b"ROBOT")
    tail = (_POSES + 5 if moving else 0) + _STAMPS
    line.has(after + tail, f" for {count} readings and {remissions} remissions")
    ranges = line.numbers("range", _HEAD_WORDS, count, finite=False)
    pose = line.numbers("pose", after, _POSES) if moving else None
    laser = Laser(*line.numbers("laser", 2, 4))
    return Message(ranges, pose, line.stamp(after + tail - _STAMPS), laser)


def read_odom(line: Line) -> list[float]:
    """x, y, theta (m, rad) and time (s) of an ODOM line."""
    line.has(10, "")
    return [*line.numbers("pose", 1, 3), line.stamp(7)]
