"""Trajectories, and how they are kept in files.

A trajectory file is in the TUM format: a line ``stamp tx ty tz qx qy qz qw`` a pose (s, m, unit
quaternion). evo reads it; it takes a while to import, so it is imported where used.
"""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.bounded import size_of
from rbtm_bench.core.errors import DataError
from rbtm_bench.core.files import write_atomically
from rbtm_bench.core.types import Array

Mask = NDArray[np.bool_]

QUATERNION_TOLERANCE = 1e-3
"""How far from 1 the norm of a quaternion in a file may be; evo takes any norm in silence."""


def orthonormalised(T: Array) -> Array:
    """Motions (..., 4, 4) with their nearly orthonormal rotations pulled back onto SO(3).

    One Newton-Schulz step towards the polar factor, R (3 I - R^T R) / 2 (Bjoerck and Bowie 1971):
    an error e of orthonormality becomes about e^2, and a planar motion stays exactly planar.
    Meant for rounding errors, not to repair a matrix that never was a rotation.
    """
    R = T[..., :3, :3]
    out = T.copy()
    out[..., :3, :3] = 1.5 * R - 0.5 * R @ (np.swapaxes(R, -1, -2) @ R)
    return out


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses in the order of the scans.

    ``stamps`` (N,) s, in any order (logs exist that step back in time); ``T_world_scan``
    (N, 4, 4). A matrix of NaN stands for a pose that is not known. Raises ``ValueError`` for
    arrays of other shapes.
    """

    stamps: Array
    T_world_scan: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "stamps", np.asarray(self.stamps, dtype=float))
        object.__setattr__(self, "T_world_scan", np.asarray(self.T_world_scan, dtype=float))
        n = len(self.stamps)
        if self.stamps.shape != (n,) or self.T_world_scan.shape != (n, 4, 4):
            raise ValueError(
                f"stamps {self.stamps.shape} and poses {self.T_world_scan.shape}, "
                "expected (N,) and (N, 4, 4)"
            )

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def known(self) -> Mask:
        """Which poses are known (N,): those without NaN or infinity."""
        return np.asarray(np.isfinite(self.T_world_scan).all(axis=(1, 2)))

    def since(self, first: int) -> Trajectory:
        """The poses from the one with this number on."""
        return Trajectory(self.stamps[first:], self.T_world_scan[first:])

    def write_tum(self, path: str | os.PathLike[str]) -> None:
        """Write a TUM file, complete or not at all.

        With 19 significant digits, as evo writes them, stamps and positions come back bit for bit
        and rotations to about 1e-15. Raises ``DataError`` if there are no poses, one is not known
        (the format has no word for it), or the file cannot be written.
        """
        from scipy.spatial.transform import Rotation

        if len(self) == 0 or not self.known.all() or not np.isfinite(self.stamps).all():
            raise DataError(f"{path}: a TUM file needs at least one pose, and every pose known")
        quaternions = Rotation.from_matrix(self.T_world_scan[:, :3, :3]).as_quat(canonical=True)
        rows = np.column_stack([self.stamps, self.T_world_scan[:, :3, 3], quaternions])

        def write(partial: Path) -> None:
            # An open file, because numpy compresses by the ending of a name.
            with open(partial, "w", encoding="utf-8", newline="\n") as file:
                np.savetxt(file, rows)

        try:
            write_atomically(Path(path), write)
        except OSError as error:
            raise DataError(f"{path}: cannot be written: {error.strerror or error}") from error

    @classmethod
    def read_tum(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Read a TUM file through evo; stamps keep their order.

        Raises ``DataError`` with file and line if it is missing, empty or malformed, or holds a
        number that is not finite or a quaternion whose norm is off 1 by more than 1e-3.
        """
        from evo.tools.file_interface import FileInterfaceException, read_tum_trajectory_file
        from scipy.spatial.transform import Rotation

        size_of(Path(path))
        try:
            with open(path, encoding="utf-8-sig", newline="") as file:
                poses = read_tum_trajectory_file(file)
        except OSError as error:
            raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error
        except (FileInterfaceException, csv.Error, ValueError) as error:
            # evo says what is wrong, but not where.
            raise _first_fault(path) or DataError(f"{path}: {error}") from error
        # evo warns of neither of these.
        quaternions = poses.orientations_quat_wxyz
        values = np.column_stack([poses.timestamps, poses.positions_xyz, quaternions])
        norms = np.linalg.norm(quaternions, axis=1)
        if not (np.isfinite(values).all() and _is_unit(norms).all()):
            raise _first_fault(path) or DataError(f"{path}: not a TUM trajectory")
        T = np.tile(np.eye(4), (len(values), 1, 1))
        T[:, :3, 3] = poses.positions_xyz
        T[:, :3, :3] = Rotation.from_quat(quaternions, scalar_first=True).as_matrix()
        return cls(stamps=poses.timestamps, T_world_scan=T)


def _is_unit(norms: Any) -> Any:
    return np.abs(norms - 1.0) <= QUATERNION_TOLERANCE


def _first_fault(path: str | os.PathLike[str]) -> DataError | None:
    """The first line of a TUM file that is not a pose, as the error to raise."""
    expected = "stamp tx ty tz qx qy qz qw, separated by single spaces"
    number = 0
    with open(path, encoding="utf-8-sig", errors="replace") as file:
        for number, line in enumerate(file, start=1):
            if line.startswith("#"):
                continue
            fields = line.rstrip("\r\n").split(" ")
            if len(fields) != 8:
                return DataError.at(path, number, f"{len(fields)} fields", f"8: {expected}")
            try:
                values = np.array([float(field) for field in fields])
            except ValueError:
                return DataError.at(path, number, "pose", f"8 numbers: {expected}")
            if not np.isfinite(values).all():
                return DataError.at(path, number, "pose", "finite numbers")
            if not _is_unit(np.linalg.norm(values[4:])):
                return DataError.at(path, number, "quaternion", "norm 1")
    return DataError.at(path, max(number, 1), "poses", f"at least one line {expected}")
