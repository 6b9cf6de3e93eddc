"""Read trajectory files: TUM or KITTI format, distinguished by the number of columns."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.geometry import to_rotation
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.files import data_lines, read_bytes, to_numbers

TUM_COLUMNS, KITTI_COLUMNS = 8, 12

ROTATION_TOLERANCE = 1e-2
"""How far written rotations may be from exact ones; printed digits are few."""


def read_poses(path: str | Path) -> tuple[Array | None, Array]:
    """Stamps (N,) s, None for KITTI, and poses T_world_sensor (N, 4, 4) of a trajectory file.

    TUM: ``t x y z qx qy qz qw``; KITTI: the first three rows of the matrix. Blank lines and
    # comments are left out, rotations are made exact. Raises ``DataError`` with file and line.
    """
    rows = data_lines(read_bytes(path))
    if not rows:
        raise DataError(f"{path}: no pose in the file")
    columns = len(rows[0][1])
    if columns not in (TUM_COLUMNS, KITTI_COLUMNS):
        expected = "8 columns (TUM: t x y z qx qy qz qw) or 12 (KITTI: 3 x 4 matrix)"
        raise DataError.at(path, rows[0][0], "pose", f"{expected}, {columns} found")
    for line, words in rows:
        if len(words) != columns:
            raise DataError.at(path, line, "pose", f"{columns} columns, {len(words)} found")
        values = np.array(to_numbers(path, line, "pose", words))
        if not _is_rotation(values):
            raise DataError.at(
                path, line, "pose", "a rotation, found a matrix or quaternion of none"
            )
    # Once every line is known to be good, with single blanks as evo wants them.
    return _evo_poses(
        io.StringIO("\n".join(b" ".join(words).decode() for _, words in rows)), columns
    )


def _is_rotation(values: Array) -> bool:
    if len(values) == TUM_COLUMNS:
        return bool(abs(np.linalg.norm(values[4:]) - 1.0) < ROTATION_TOLERANCE)
    R = values.reshape(3, 4)[:, :3]
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
