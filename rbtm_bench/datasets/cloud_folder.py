"""A folder of point clouds, one file a scan, and their trajectory file, if any."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.association import time_suspicions
from rbtm_bench.datasets.base import Dataset, Drops, Reading
from rbtm_bench.datasets.binary_layouts import LAYOUTS, find_layout
from rbtm_bench.datasets.cloud_files import SUFFIXES, TEXT, check_file, read_points, usable
from rbtm_bench.datasets.cloud_frame import find_frame
from rbtm_bench.datasets.cloud_times import Matched, list_files, match_poses, times_of
from rbtm_bench.datasets.files import reader
from rbtm_bench.datasets.truth_fit import truth_doubt

VERSION = "cloud-folder-1"
"""Part of the fingerprint: change it whenever the same files and settings give other scans."""

LAYOUT = Literal["auto", "kitti", "nuscenes", "boreas", "nclt", "xyz", "xyz64", "xyzi64"]
Index = Annotated[int, Ge(0)]

FEW_STEPS = 5
"""Clouds at the start among which truth is held against the clouds."""


class CloudFolder(Dataset):
    """The cloud files of a folder: .ply, .pcd, .bin, .npy (N, 3+) or .xyz, all of one format;
    .csv and .txt, which may be anything, where ``pattern`` ends so.

    ``pattern`` is a glob inside ``path``; names with a dot in front are no data; files sort
    naturally (2 before 10) or as decimal numbers. ``layout`` is that of .bin files, ``columns`` are
    those of x, y, z in arrays, ``scale`` the metres in a unit, ``frame`` that of the points; each
    is found out from the files and refused where that is unsure.

    ``poses`` is a TUM or KITTI trajectory of T_world_sensor, the ground truth, ``odometry`` another
    one. Names that are times give the stamps, and poses belong to the clouds nearest in time
    within ``tolerance_s`` (s); else the poses are those of the clouds in order, and their stamps
    are the scans' (TUM), or 1 / ``rate_hz`` s apart. A scan may lack a truth, but no odometry.

    Points that are not finite, implausible, not farther than ``min_range`` (m) or not nearer than
    ``max_range`` (m) are dropped and counted; a cloud with none left is an error. Only the first
    ``max_scans`` files are used.

    One cloud is in memory at a time. Opening checks names, sizes and counts; what only shows
    inside a file is raised by ``dataset[i]``. With ``on_error`` "skip" every file is read once
    when the folder is opened, and bad ones are left out and counted in ``skipped``.

    Raises ``DataError`` (a bad folder, cloud or trajectory) and ``ConfigError`` (a bad pattern).
    """

    def __init__(
        self,
        path: str,
        poses: str | None = None,
        odometry: str | None = None,
        pattern: str = "*",
        layout: LAYOUT = "auto",
        columns: tuple[Index, Index, Index] | None = None,
        scale: Literal["auto"] | Annotated[float, Gt(0)] = "auto",
        frame: Literal["auto", "sensor", "world"] = "auto",
        rate_hz: Annotated[float, Gt(0)] = 10.0,
        tolerance_s: Annotated[float, Gt(0)] = 0.02,
        min_range: Annotated[float, Ge(0)] = 0.0,
        max_range: Annotated[float, Gt(0)] | None = None,
        max_scans: Annotated[int, Ge(1)] | None = None,
        on_error: Literal["raise", "skip"] = "raise",
    ) -> None:
        self.min_range = float(min_range)
        self.max_range = np.inf if max_range is None else float(max_range)
        self._drops, self._columns = Drops(), columns
        named = tuple(suffix for suffix in TEXT if pattern.lower().endswith(suffix))
        files = list_files(path, pattern, SUFFIXES + named)
        self._layout = self._find_layout(files, layout, on_error)
        times = times_of(files)
        self.stamps = np.arange(len(files)) / rate_hz if times is None else times
        self._times = _times_reading(times, rate_hz)
        match = (len(files), times, rate_hz, tolerance_s)
        self.ground_truth = self._matched(poses, "truth", *match)
        self.odometry = self._matched(odometry, "odometry", *match)
        if self.odometry is not None and not np.isfinite(self.odometry[:max_scans]).all():
            count = np.count_nonzero(np.isfinite(self.odometry).all(axis=(1, 2)))
            raise DataError(f"{odometry}: odometry for {count} of {len(files)} clouds only")
        self.readings += (self._times,)
        used = [i for i in range(len(files))[:max_scans] if self._usable(files[i], on_error)]
        if not used:
            raise DataError(f"{path}: no usable cloud, {self.skipped} malformed")
        self._take(files, used)
        self.suspicions += tuple(time_suspicions(self.stamps))
        self._frame = find_frame(path, *self._samples(), scale, frame)
        self.readings += self._frame.readings
        self.suspicions += self._frame.suspicions
        if self._frame.way == "sensor":
            self.suspicions += self._truth_doubts()
        self._settings = [VERSION, self.min_range, self.max_range, on_error]
        self._settings += self._frame.unusual()
        self._settings += [] if self._layout == "kitti" else [self._layout]
        self._settings += [columns] if columns else []
        self._fingerprint: str | None = None

    def _take(self, files: list[Path], used: list[int]) -> None:
        """Keep the files that are used, with what belongs to them."""
        self.files = [files[i] for i in used]
        self.stamps = self.stamps[used]
        if self.ground_truth is not None:
            self.ground_truth = self.ground_truth[used]
        if self.odometry is not None:
            self.odometry = self.odometry[used]
        self.has_odometry = self.odometry is not None
        self.has_ground_truth = bool(
            self.ground_truth is not None and np.isfinite(self.ground_truth[:, 0, 0]).any()
        )

    def _find_layout(self, files: list[Path], layout: LAYOUT, on_error: str) -> str:
        """The layout of .bin files; "kitti", which says nothing, for others."""
        if files[0].suffix.lower() != ".bin":
            return "kitti"
        why = "as asked for"
        name: str = layout
        if layout == "auto":
            try:
                name, why = find_layout(files)
            except DataError:
                if on_error == "raise":
                    raise
                name, why = "kitti", "not to be told: some files are damaged"
        self.readings += (Reading("layout", f"{name}: {LAYOUTS[name].words}", why, "layout"),)
        return name

    def _matched(
        self,
        path: str | None,
        role: str,
        clouds: int,
        times: Array | None,
        rate_hz: float,
        tolerance_s: float,
    ) -> Array | None:
        if path is None:
            return None
        matched: Matched = match_poses(path, role, clouds, times, rate_hz, tolerance_s)
        self.readings += (matched.reading,)
        self.suspicions += matched.suspicions
        if matched.stamps is not None and (role == "truth" or self.ground_truth is None):
            self.stamps = matched.stamps
            self._times = Reading("times", path, "the trajectory's, one a cloud", "")
        return matched.poses

    def _samples(self) -> tuple[list[Array], list[Array | None]]:
        """First, middle and last cloud that can be read, with their true poses."""
        count = len(self.files)
        clouds: list[Array] = []
        poses: list[Array | None] = []
        for i in sorted({0, count // 2, count - 1}):
            try:
                points = read_points(self.files[i], self._layout, self._columns)
            except DataError:
                continue  # raised where the scan is asked for
            clouds.append(points)
            poses.append(self._truth(i))
        return clouds, poses

    def _truth_doubts(self) -> tuple[str, ...]:
        """Whether the first cloud and one a few steps on fit each other otherwise than by truth."""
        known = [i for i in range(min(len(self.files), FEW_STEPS)) if self._truth(i) is not None]
        if len(known) < 2:
            return ()
        ends = (known[0], known[-1])
        try:
            clouds = [read_points(self.files[i], self._layout, self._columns) for i in ends]
        except DataError:
            return ()  # raised where the scan is asked for
        poses = [T for i in ends if (T := self._truth(i)) is not None]
        doubt = truth_doubt([self._frame.metres(c, None) for c in clouds], poses)
        return (doubt,) if doubt else ()

    def _truth(self, index: int) -> Array | None:
        if self.ground_truth is None or not np.isfinite(self.ground_truth[index, 0, 0]):
            return None
        return self.ground_truth[index]

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, index: int) -> Scan:
        if not 0 <= index < len(self):
            raise IndexError(f"scan {index} of {len(self)}")
        return Scan(
            index=index,
            stamp=float(self.stamps[index]),
            points=self._points(index),
            odometry=None if self.odometry is None else self.odometry[index],
            ground_truth=self._truth(index),
        )

    def fingerprint(self) -> str:
        """sha256 of all clouds, the poses, the stamps and the settings; reads every file once."""
        if self._fingerprint is None:
            digest = hashlib.sha256(repr(self._settings).encode())
            digest.update(self.stamps.tobytes())
            for poses in (self.ground_truth, self.odometry):
                if poses is not None:
                    digest.update(poses.tobytes())
            for file in self.files:
                digest.update(_digest(file))
            self._fingerprint = digest.hexdigest()
        return self._fingerprint

    def dropped(self) -> dict[str, int]:
        return self._drops.total()

    def _points(self, index: int) -> Array:
        file = self.files[index]
        points = read_points(file, self._layout, self._columns)
        points = self._frame.metres(points, self._truth(index))
        kept, causes = usable(file, points, self.min_range, self.max_range)
        self._drops.note(index, **causes)
        return kept

    def _usable(self, file: Path, on_error: str) -> bool:
        if on_error == "raise":
            check_file(file, self._layout)
            return True
        try:
            points = read_points(file, self._layout, self._columns)
            if not np.isfinite(points).all(axis=1).any():
                raise DataError(f"{file}: no point within range")
        except DataError:
            self.skipped += 1
            return False
        return True


def _times_reading(times: Array | None, rate_hz: float) -> Reading:
    if times is not None:
        return Reading("times", "the names of the files", "numbers that are times", "")
    return Reading("times", f"{rate_hz:g} Hz", "no times in the names of the files", "rate_hz")


@reader
def _digest(file: Path) -> bytes:
    with open(file, "rb") as content:
        return hashlib.file_digest(content, "sha256").digest()
