"""A folder of point clouds, one file a scan, and their trajectory file, if any."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.datasets.cloud_files import SUFFIXES, check_file, read_points
from rbtm_bench.datasets.poses_file import read_poses

VERSION = "cloud-folder-1"
"""Part of the fingerprint: change it whenever the same files and settings give other scans."""


class CloudFolder(Dataset):
    """The cloud files of a folder: .ply, .pcd, .bin (KITTI: float32 x y z intensity), .npy (N, 3+).

    ``pattern`` is a glob inside ``path``; files sort naturally (2 before 10). ``poses`` is a TUM
    or KITTI trajectory of T_world_sensor with one pose a file, the ground truth; its stamps are
    the scans' (TUM), else stamps are 1 / ``rate_hz`` s apart. Points that are not finite, not
    farther than ``min_range`` (m) or not nearer than ``max_range`` (m) are dropped; a cloud with
    none left is an error. Only the first ``max_scans`` files are used.

    One cloud is in memory at a time. Opening checks names, sizes and counts; what only shows
    inside a file is raised by ``dataset[i]``. With ``on_error`` "skip" every file is read once
    when the folder is opened, and bad ones are left out and counted in ``skipped``.

    Raises ``DataError`` (a bad folder, cloud or trajectory) and ``ConfigError`` (a bad pattern).
    """

    def __init__(
        self,
        path: str,
        poses: str | None = None,
        pattern: str = "*",
        rate_hz: Annotated[float, Gt(0)] = 10.0,
        min_range: Annotated[float, Ge(0)] = 0.0,
        max_range: Annotated[float, Gt(0)] | None = None,
        max_scans: Annotated[int, Ge(1)] | None = None,
        on_error: Literal["raise", "skip"] = "raise",
    ) -> None:
        self.min_range = float(min_range)
        self.max_range = np.inf if max_range is None else float(max_range)
        files = _list_files(path, pattern)
        stamps, ground_truth = _read_trajectory(poses, path, len(files))
        self.has_ground_truth = ground_truth is not None
        if stamps is None:
            stamps = np.arange(len(files)) / rate_hz
        used = [i for i in range(len(files))[:max_scans] if self._usable(files[i], on_error)]
        if not used:
            raise DataError(f"{path}: no usable cloud, {self.skipped} malformed")
        self.files = [files[i] for i in used]
        self.stamps = stamps[used]
        self.ground_truth = None if ground_truth is None else ground_truth[used]
        self._settings = [VERSION, self.min_range, self.max_range, on_error]
        self._fingerprint: str | None = None

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, index: int) -> Scan:
        if not 0 <= index < len(self):
            raise IndexError(f"scan {index} of {len(self)}")
        return Scan(
            index=index,
            stamp=float(self.stamps[index]),
            points=self._points(self.files[index]),
            ground_truth=None if self.ground_truth is None else self.ground_truth[index],
        )

    def fingerprint(self) -> str:
        """sha256 of all clouds, the poses, the stamps and the settings; reads every file once."""
        if self._fingerprint is None:
            digest = hashlib.sha256(repr(self._settings).encode())
            digest.update(self.stamps.tobytes())
            if self.ground_truth is not None:
                digest.update(self.ground_truth.tobytes())
            for file in self.files:
                digest.update(hashlib.sha256(_content(file)).digest())
            self._fingerprint = digest.hexdigest()
        return self._fingerprint

    def _points(self, file: Path) -> Array:
        points = read_points(file)
        distance = np.linalg.norm(points, axis=1)
        # NaN and infinity fail both comparisons, and so does a point in the sensor itself, which
        # is how organised clouds write "no return".
        kept: Array = points[(distance > self.min_range) & (distance < self.max_range)]
        if len(kept) == 0:
            raise DataError(f"{file}: no point within range ({len(points)} points in the file)")
        return kept

    def _usable(self, file: Path, on_error: str) -> bool:
        if on_error == "raise":
            check_file(file)
            return True
        try:
            self._points(file)
        except DataError:
            self.skipped += 1
            return False
        return True


def _list_files(path: str, pattern: str) -> list[Path]:
    folder = Path(path)
    if not folder.is_dir():
        what = "expected a folder, found a file" if folder.exists() else "no such folder"
        raise DataError(f"{path}: {what}")
    try:
        matches = [file for file in folder.glob(pattern) if file.is_file()]
    except (ValueError, NotImplementedError) as error:
        raise ConfigError(f"pattern={pattern!r}: {error}") from None
    files = [file for file in matches if file.suffix.lower() in SUFFIXES]
    if not files:
        raise DataError(f"{path}: no {', '.join(SUFFIXES)} file matches pattern {pattern!r}")
    return sorted(files, key=lambda file: natural_key(file.relative_to(folder).as_posix()))


def natural_key(name: str) -> tuple[list[str | int], str]:
    """Sorts names as people do: digits as numbers, so 2 comes before 10."""
    parts = re.split(r"([0-9]+)", name)
    return [int(part) if i % 2 else part for i, part in enumerate(parts)], name


def _read_trajectory(
    poses: str | None, path: str, clouds: int
) -> tuple[Array | None, Array | None]:
    if poses is None:
        return None, None
    stamps, ground_truth = read_poses(poses)
    if len(ground_truth) != clouds:
        raise DataError(f"{poses}: {len(ground_truth)} poses for {clouds} clouds in {path}")
    return stamps, ground_truth


def _content(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError as error:
        raise DataError(f"{file}: {error.strerror or error}") from None
