"""Read trajectory files: TUM or KITTI format, distinguished by the number of columns."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.geometry import to_rotation
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.files import comments, data_lines, read_bytes, reader, to_numbers

TUM_COLUMNS, KITTI_COLUMNS = 8, 12
TUM_NAMES = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
IN_ORDER = list(range(8))

ROTATION_TOLERANCE = 1e-2
"""How far written rotations may be from exact ones; printed digits are few."""
FARTHEST = 1e7
"""m; no pose on Earth is farther from an origin."""
LATEST = 1e11
"""s; a time beyond is in ns, us or ms."""


@dataclass(frozen=True, eq=False)
class PosesFile:
    """``stamps`` (N,) s, None for KITTI, and ``poses`` T_world_sensor (N, 4, 4), in the order of
    the file; ``note`` says what names or numbers told of the columns."""

    stamps: Array | None
    poses: Array
    note: str = ""


def read_poses(path: str | Path) -> tuple[Array | None, Array]:
    """Stamps (N,) s, None for KITTI, and poses T_world_sensor (N, 4, 4) of a trajectory file."""
    file = read_poses_file(path)
    return file.stamps, file.poses


@reader
def read_poses_file(path: str | Path) -> PosesFile:
    """A trajectory file.

    TUM: ``t x y z qx qy qz qw``, or as the names in a comment or first line order them; KITTI: the
    first three rows of the matrix. Blank lines and # comments are left out; blanks, commas and
    semicolons separate; rotations are made exact. Raises ``DataError`` with file and line.
    """
    rows, names = _table(read_bytes(path))
    if not rows:
        raise DataError(f"{path}: no pose in the file")
    columns = len(rows[0][1])
    order = _order(names) if len(names) == columns else None
    if order is None and columns not in (TUM_COLUMNS, KITTI_COLUMNS):
        expected = "8 columns (TUM: t x y z qx qy qz qw) or 12 (KITTI: 3 x 4 matrix)"
        raise DataError.at(path, rows[0][0], "pose", f"{expected}, {columns} found")
    values = np.array([_row(path, line, words, columns) for line, words in rows])
    note = "" if order in (None, IN_ORDER) else f"columns by their names: {' '.join(names)}"
    if order is None and columns == TUM_COLUMNS and _scalar_first(values[:, 4:]):
        order, note = [0, 1, 2, 3, 5, 6, 7, 4], "qw qx qy qz: the first pose is 1 0 0 0"
    if order is not None:
        rows = [(line, [words[i] for i in order]) for line, words in rows]
        values, columns = values[:, order], TUM_COLUMNS
    for (line, _), row in zip(rows, values, strict=True):
        _check(path, line, row)
    # Once every line is known to be good, with single blanks as evo wants them.
    text = "\n".join(b" ".join(words).decode() for _, words in rows)
    stamps, poses = _evo_poses(io.StringIO(text), columns)
    if stamps is not None and np.abs(stamps).max() > LATEST:
        digits = len(str(int(np.abs(stamps).max())))
        unit = {13: 1e3, 16: 1e6, 19: 1e9}.get(digits)
        if unit is None:
            raise DataError(f"{path}: times of {digits} digits: expected s, ms, us or ns")
        stamps, note = stamps / unit, f"{note}; times in 1/{unit:g} s".strip("; ")
    return PosesFile(stamps, poses, note)


def _table(content: bytes) -> tuple[list[tuple[int, list[bytes]]], list[str]]:
    """The lines with numbers, and the names of the columns, if the file has any."""
    rows = data_lines(content)
    lines = list(comments(content))
    if rows and re.match(rb"[a-zA-Z]", rows[0][1][0]) and len(rows[0][1]) >= TUM_COLUMNS:
        lines.append(b" ".join(rows[0][1]).decode("latin-1").lower())
        rows = rows[1:] if _named(lines[-1:]) else rows
    return rows, _named(lines)


def _named(lines: list[str]) -> list[str]:
    """The names of columns in the last line that has them, in lower case."""
    for line in reversed(lines):
        names = re.sub(r"\[[^\]]*\]|\([^)]*\)", " ", line.strip().lstrip("#"))
        words = re.split(r"[\s,;]+", names.strip())
        if len(words) >= TUM_COLUMNS and _order(words) is not None:
            return words
    return []


def _scalar_first(quaternions: Array) -> bool:
    """Whether the first pose is no turn, and all are small ones, if their scalars come first."""
    first = np.array_equal(quaternions[0], [1.0, 0.0, 0.0, 0.0])
    return first and bool((np.abs(quaternions[:, 0]) >= np.abs(quaternions[:, 3])).all())


def _row(path: str | Path, line: int, words: list[bytes], columns: int) -> list[float]:
    if len(words) != columns:
        raise DataError.at(path, line, "pose", f"{columns} columns, {len(words)} found")
    return to_numbers(path, line, "pose", words)


def _check(path: str | Path, line: int, values: Array) -> None:
    lengths = values[1:4] if len(values) == TUM_COLUMNS else values[3::4]
    if np.abs(lengths).max() > FARTHEST:
        raise DataError.at(path, line, "pose", f"a position within {FARTHEST:g} m")
    if not _is_rotation(values):
        raise DataError.at(path, line, "pose", "a rotation, found a matrix or quaternion of none")


def _order(names: list[str]) -> list[int] | None:
    """Where t, x, y, z, qx, qy, qz and qw stand among the names; None if one is missing."""
    found: dict[str, int] = {}
    for index, name in enumerate(names):
        match = re.fullmatch(r"q.*?_?([xyzw])|(?:.*_)?q([xyzw])", name)
        if match:
            key = f"q{match[1] or match[2]}"
        elif re.match(r"t$|time|stamp|#?timestamp", name):
            key = "t"
        else:
            place = re.fullmatch(r"(?:t|p|p_.*|pos.*|field\..*)?_?([xyz])", name)
            key = place[1] if place else ""
        if key:
            found.setdefault(key, index)
    return [found[key] for key in TUM_NAMES] if found.keys() >= set(TUM_NAMES) else None


def _is_rotation(values: Array) -> bool:
    if len(values) == TUM_COLUMNS:
        return bool(abs(np.linalg.norm(values[4:]) - 1.0) < ROTATION_TOLERANCE)
    R = values.reshape(3, 4)[:, :3]
    if np.abs(R).max() > 2.0:
        return False
    exact = np.abs(R @ R.T - np.eye(3)).max() < ROTATION_TOLERANCE
    return bool(exact and np.linalg.det(R) > 0)


def _evo_poses(text: io.StringIO, columns: int) -> tuple[Array | None, Array]:
    from evo.tools import file_interface

    if columns == TUM_COLUMNS:
        trajectory = file_interface.read_tum_trajectory_file(text)
        return np.asarray(trajectory.timestamps), np.stack(trajectory.poses_se3)
    poses = np.stack(file_interface.read_kitti_poses_file(text).poses_se3)
    poses[:, :3, :3] = [to_rotation(R) for R in poses[:, :3, :3]]
    return None, poses
