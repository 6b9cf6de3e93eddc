"""What is particular to each of KISS-ICP's loaders: files, times, and where it is put right."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.association import nearest
from rbtm_bench.datasets.binary_layouts import read_layout
from rbtm_bench.datasets.cloud_files import SUFFIXES, read_points
from rbtm_bench.datasets.cloud_times import times_of
from rbtm_bench.datasets.files import data_lines, file_size, read_bytes, reader, to_numbers
from rbtm_bench.datasets.poses_file import read_poses_file

TYPES = {"f": "<f4", "B": "u1", "H": "<u2", "I": "<u4", "L": "<u4", "l": "<i4"}
"""Letters of HeLiPR's records (struct's, without padding) as numpy's types."""
AEVA_CHANGED = 1691936557946849179
"""ns; HeLiPR's Aeva wrote no intensity up to here."""
NCLT_UP = np.array([1.0, -1.0, -1.0])
"""NCLT's z axis points down; KISS-ICP turns points and poses."""

Times = Callable[[Path, Any, list[Path]], Array | None]


@dataclass(frozen=True)
class Format:
    """A loader: ``files`` and ``times`` (s; None if unknown) of its scans, ``truth`` of a loader
    (N, 4, 4), NaN where unknown, ``points`` of a file where not the loader's own, whether it
    asks for a ``sequence``, whether its path is ``one_file`` that holds all scans, and the maker's
    ``module`` and ``package`` that it needs."""

    files: Callable[[Path, Any], list[Path]]
    times: Times
    truth: Callable[[Path, Any, Array | None, float], Array | None]
    points: Callable[[Path, Any], Array] | None = None
    sequence: bool = False
    one_file: bool = False
    module: str = ""
    package: str = ""


def scan_files(path: Path, loader: Any) -> list[Path]:
    """The loader's own list."""
    return [Path(str(file)) for file in loader.scan_files]


def _ncd_files(path: Path, loader: Any) -> list[Path]:
    return [Path(loader.scan_folder) / str(file) for file in loader.scan_files]


def _tum_files(path: Path, loader: Any) -> list[Path]:
    return [path / str(row[-1]) for row in loader.depth_frames]


def _nuscenes_records(loader: Any) -> list[Any]:
    return [loader.nusc.get("sample_data", token) for token in loader.lidar_tokens]


def _nuscenes_files(path: Path, loader: Any) -> list[Path]:
    return [path / str(record["filename"]) for record in _nuscenes_records(loader)]


def _nuscenes_times(path: Path, loader: Any, files: list[Path]) -> Array | None:
    return np.array([1e-6 * float(record["timestamp"]) for record in _nuscenes_records(loader)])


def _nuscenes_points(file: Path, loader: Any) -> Array:
    return read_layout(file, "nuscenes")


def _packets(path: Path, loader: Any) -> list[Path]:
    """The one file of all scans, once a scan."""
    return [path] * len(loader)


def _unknown(path: Path, loader: Any, files: list[Path]) -> Array | None:
    return None


def _by_name(path: Path, loader: Any, files: list[Path]) -> Array | None:
    return times_of(files)


def _ncd_times(path: Path, loader: Any, files: list[Path]) -> Array | None:
    found = [re.fullmatch(r"cloud_(\d+)_(\d+)", file.stem) for file in files]
    return np.array([int(m[1]) + 1e-9 * int(m[2]) for m in found if m is not None])


def _tum_times(path: Path, loader: Any, files: list[Path]) -> Array | None:
    return np.array([float(row[0]) for row in loader.depth_frames])


def _apollo_times(path: Path, loader: Any, files: list[Path]) -> Array | None:
    return first_column(path / "poses" / "gt_poses.txt", 1)


def _raw_times(path: Path, loader: Any, files: list[Path]) -> Array | None:
    """KITTI's dates, 2011-10-03 12:55:34.997992704, of all scans of the drive."""
    listed = Path(loader.velodyne_dir).parent / "timestamps.txt"
    if not listed.is_file():
        return None
    times = []
    for line, text in enumerate(read_bytes(listed).decode("latin-1").split("\n"), start=1):
        whole, _, fraction = text.strip().partition(".")
        if not whole:
            continue
        try:
            seconds = datetime.fromisoformat(whole + "+00:00").timestamp()
            times.append(seconds + float(f"0.{fraction or 0}"))
        except ValueError:
            raise DataError.at(listed, line, "time", "a date and time") from None
    first = int(loader.valid_idx[0])
    if len(times) < first + len(files):
        raise DataError(f"{listed}: {len(times)} times for scan {first + len(files) - 1}")
    return np.array(times[first : first + len(files)])


@reader
def first_column(path: Path, column: int = 0) -> Array:
    """A column of a table of numbers; a first line of names is left out."""
    values: list[float] = []
    for line, words in data_lines(read_bytes(path)):
        if not values and not re.match(rb"[-+.\d]", words[0]):
            continue
        values += to_numbers(path, line, "time", words[column : column + 1])
    return np.array(values)


def _own(path: Path, loader: Any, times: Array | None, tolerance_s: float) -> Array | None:
    return np.asarray(loader.gt_poses, dtype=np.float64)


def _none(path: Path, loader: Any, times: Array | None, tolerance_s: float) -> Array | None:
    return None


def _in_time(table: Callable[[Path], Path], unit: float) -> Callable[..., Array | None]:
    """The loader's own, which takes the nearest pose however far it is in time: only those within
    the tolerance."""

    def truth(path: Path, loader: Any, times: Array | None, tolerance_s: float) -> Array | None:
        poses = np.array(loader.gt_poses, dtype=np.float64)
        if times is not None:
            known = unit * first_column(table(path))
            poses[nearest(known, times, tolerance_s) < 0] = np.nan
        return poses

    return truth


def _tum_truth(path: Path, loader: Any, times: Array | None, tolerance_s: float) -> Array | None:
    """By time: the loader leaves out repeated poses, so that those behind them are others'."""
    file = read_poses_file(path / "groundtruth.txt")
    if file.stamps is None or times is None:
        raise DataError(f"{path / 'groundtruth.txt'}: expected t x y z qx qy qz qw")
    found = nearest(file.stamps, times, tolerance_s)
    poses = np.full((len(times), 4, 4), np.nan)
    poses[found >= 0] = file.poses[found[found >= 0]]
    return poses


def _nclt_points(file: Path, loader: Any) -> Array:
    """With unsigned coordinates: the loader's wrap round at 64 m."""
    file_size(file)
    return read_layout(file, "nclt") * NCLT_UP


def _cloud_points(file: Path, loader: Any) -> Array:
    """By our own readers, which hold the header against the file; pyntcloud, by which ncd would
    read, cannot read binary files with numpy 2."""
    if file.suffix.lower() in SUFFIXES:
        return read_points(file)
    return np.asarray(loader.read_point_cloud(str(file))[0], dtype=np.float64)


def _helipr_points(file: Path, loader: Any) -> Array:
    """All records: the loader leaves out the last of each file."""
    letters = loader.format_string
    if loader.sequence_id == "Aeva" and int(file.stem) <= AEVA_CHANGED:
        letters = loader.format_string_no_intensity
    record = np.dtype([(f"{i}{letter}", TYPES[letter]) for i, letter in enumerate(letters)])
    if file_size(file) % record.itemsize:
        raise DataError(f"{file}: expected records of {record.itemsize} bytes")
    rows = np.fromfile(file, record)
    return np.column_stack([rows[f"{i}f"].astype(np.float64) for i in range(3)])


FORMATS = {
    "apollo": Format(scan_files, _apollo_times, _own, _cloud_points),
    "boreas": Format(scan_files, _by_name, _own),
    "generic": Format(scan_files, _by_name, _none, _cloud_points),
    "helipr": Format(scan_files, _by_name, _own, _helipr_points, sequence=True),
    "kitti_raw": Format(scan_files, _raw_times, _own, sequence=True),
    "mulran": Format(scan_files, _by_name, _in_time(lambda path: path / "global_pose.csv", 1e-9)),
    "ncd": Format(_ncd_files, _ncd_times, _own, _cloud_points),
    "nclt": Format(
        lambda path, loader: [Path(loader.scans_dir) / str(file) for file in loader.scan_files],
        _by_name,
        _in_time(lambda path: path.parent / "ground_truth" / f"groundtruth_{path.name}.csv", 1e-6),
        _nclt_points,
    ),
    "nuscenes": Format(
        _nuscenes_files,
        _nuscenes_times,
        _own,
        _nuscenes_points,
        sequence=True,
        module="nuscenes",
        package="nuscenes-devkit",
    ),
    "ouster": Format(
        _packets, _unknown, _none, one_file=True, module="ouster", package="ouster-sdk"
    ),
    "tum": Format(_tum_files, _tum_times, _tum_truth),
}
