"""Damaged copies of good files, seeded, and what may become of them: an error of ours, or points
that could be, every one of them accounted for."""

from __future__ import annotations

import gzip
import shutil
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from carmen_writer import compose, drive, flaser, odom
from cloud_helpers import write_cloud

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.datasets.carmen import Carmen
from rbtm_bench.datasets.cloud_folder import CloudFolder
from rbtm_bench.datasets.kitti import Kitti

SLOW = 10.0
"""s; a reader that takes longer on a few kilobytes hangs."""
ABSURD = 1e4
"""m in the sensor's frame."""
SMALLEST = 1e-30
POINTS = 300


@dataclass(frozen=True)
class Format:
    """``write`` makes good data in a folder and names the file to damage; ``open`` opens them."""

    write: Callable[[Path], Path]
    open: Callable[[Path], Dataset]


def cloud() -> np.ndarray:
    """A ring of walls, in the order of a scan."""
    turn = np.linspace(0, 6 * np.pi, POINTS)
    radius = 8 + 2 * np.sin(3 * turn)
    z = np.repeat([-1.0, 0.2, 1.4], POINTS // 3)
    points = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), z])
    return points.astype(np.float32).astype(float)


def _clouds(suffix: str, save: Callable[[Path, np.ndarray], None]) -> Format:
    def write(folder: Path) -> Path:
        for number in range(3):
            save(folder / f"{number}{suffix}", cloud() + 0.1 * number)
        return folder / f"1{suffix}"

    return Format(write, lambda folder: CloudFolder(str(folder)))


def _text(path: Path, points: np.ndarray) -> None:
    path.write_text("".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in points.tolist()))


def _ascii(path: Path, points: np.ndarray) -> None:
    rows = "\n".join(f"{x!r} {y!r} {z!r}" for x, y, z in points.tolist())
    names = "".join(f"property double {name}\n" for name in "xyz")
    header = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n{names}end_header\n"
    if path.suffix == ".pcd":
        header = (
            "VERSION 0.7\nFIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nCOUNT 1 1 1\n"
            f"WIDTH {len(points)}\nHEIGHT 1\nPOINTS {len(points)}\nDATA ascii\n"
        )
    path.write_text(header + rows + "\n")


def _compressed(path: Path, points: np.ndarray) -> None:
    import open3d as o3d

    o3d.io.write_point_cloud(
        path, o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)), compressed=True
    )


def write_las(path: Path, points: np.ndarray) -> None:
    """A LAS (or LAZ) file in steps of 0.1 mm."""
    import laspy

    las = laspy.create(point_format=1, file_version="1.2")
    las.header.scales = np.full(3, 1e-4)
    las.x, las.y, las.z = points.T
    las.write(path)


def log(count: int = 6) -> str:
    ranges = [3.0 + 0.01 * (i % 40) for i in range(180)]
    lines = [
        line
        for i, pose in enumerate(drive(count))
        for line in (odom(pose, i - 0.1), flaser(compose(pose, (0, 0, 0)), float(i), ranges))
    ]
    return "PARAM robot_front_laser_max 50 host 0\n" + "\n".join(lines) + "\n"


def _log(folder: Path) -> Path:
    (folder / "a.clf").write_text(log())
    return folder / "a.clf"


def _packed(folder: Path) -> Path:
    (folder / "a.clf").write_bytes(gzip.compress(log().encode(), mtime=0))
    return folder / "a.clf"


def _relations(folder: Path) -> Path:
    _log(folder)
    rows = "".join(f"{i}.0 {i + 1}.0 0.1 0 0 0 0 0.05\n" for i in range(5))
    (folder / "a.relations").write_text(rows)
    return folder / "a.relations"


def _poses(text: str) -> Format:
    def write(folder: Path) -> Path:
        (folder / "clouds").mkdir()
        for number in range(3):
            write_cloud(folder / "clouds" / f"{number}.npy", cloud() + 0.1 * number)
        (folder / "poses.txt").write_text(text)
        return folder / "poses.txt"

    return Format(
        write, lambda folder: CloudFolder(str(folder / "clouds"), poses=str(folder / "poses.txt"))
    )


def _kitti(name: str) -> Format:
    def write(folder: Path) -> Path:
        sequence = folder / "sequences" / "00"
        (sequence / "velodyne").mkdir(parents=True)
        for number in range(3):
            write_cloud(sequence / "velodyne" / f"{number:06d}.bin", cloud() + 0.1 * number)
        (sequence / "calib.txt").write_text("P0: 1 0 0 0\nTr: 0 -1 0 0 0 0 -1 0 1 0 0 0\n")
        (sequence / "times.txt").write_text("0.0\n0.1\n0.2\n")
        (folder / "poses").mkdir()
        text = "".join(f"1 0 0 {0.1 * i} 0 1 0 0 0 0 1 0\n" for i in range(3))
        (folder / "poses" / "00.txt").write_text(text)
        return folder / name

    return Format(write, lambda folder: Kitti(str(folder), 0))


FORMATS = {
    "ply": _clouds(".ply", write_cloud),
    "ply ascii": _clouds(".ply", _ascii),
    "pcd": _clouds(".pcd", write_cloud),
    "pcd ascii": _clouds(".pcd", _ascii),
    "pcd compressed": _clouds(".pcd", _compressed),
    "bin": _clouds(".bin", write_cloud),
    "npy": _clouds(".npy", write_cloud),
    "xyz": _clouds(".xyz", _text),
    "las": _clouds(".las", write_las),
    "laz": _clouds(".laz", write_las),
    "log": Format(_log, lambda folder: Carmen(str(folder / "a.clf"))),
    "log packed": Format(_packed, lambda folder: Carmen(str(folder / "a.clf"))),
    "relations": Format(
        _relations, lambda folder: Carmen(str(folder / "a.clf"), str(folder / "a.relations"))
    ),
    "tum": _poses("".join(f"{0.1 * i:.1f} {0.1 * i:.1f} 0 0 0 0 0 1\n" for i in range(3))),
    "kitti poses": _poses("".join(f"1 0 0 {0.1 * i:.1f} 0 1 0 0 0 0 1 0\n" for i in range(3))),
    "kitti scan": _kitti("sequences/00/velodyne/000001.bin"),
    "kitti calib": _kitti("sequences/00/calib.txt"),
    "kitti times": _kitti("sequences/00/times.txt"),
    "kitti truth": _kitti("poses/00.txt"),
}


def mutated(content: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    """A damaged copy of a file's content, and the kind of damage."""
    kinds = (
        "cut",
        "flip",
        "zeros",
        "insert",
        "delete",
        "repeat",
        "swap",
        "number",
        "ones",
        "bytes",
    )
    kind = str(rng.choice(kinds))
    data, size = bytearray(content), len(content)
    at = int(rng.integers(size))
    end = min(size, at + int(rng.integers(1, 64)))
    if kind == "cut":
        data = data[:at]
    elif kind == "flip":
        for place in rng.integers(size, size=int(rng.integers(1, 8))):
            data[place] ^= 1 << int(rng.integers(8))
    elif kind in ("zeros", "ones"):
        data[at:end] = (b"\0" if kind == "zeros" else b"\xff") * (end - at)
    elif kind == "insert":
        data[at:at] = rng.bytes(end - at)
    elif kind == "delete":
        del data[at:end]
    elif kind == "repeat":
        data[at:at] = data[at:end]
    elif kind == "bytes":
        data[at:end] = rng.bytes(end - at)
    elif kind == "swap":  # the byte order of everything behind a text header
        start = max(0, size - size // 4 * 4)
        body = np.frombuffer(bytes(data[start:]), "<u4").byteswap().tobytes()
        data[start:] = body
    else:  # one digit of the first lines, where counts are
        digits = [i for i, c in enumerate(data[:400]) if 48 <= c < 58] or [at]
        place = int(rng.choice(digits))
        data[place : place + 1] = str(int(rng.integers(10))).encode() * int(rng.integers(1, 9))
    return kind, bytes(data)


def outcome(form: Format, folder: Path, content: bytes) -> str:
    """What reading damaged data comes to: "refused", "read", or what must not be."""
    if folder.exists():
        shutil.rmtree(folder)
    folder.mkdir(parents=True)
    form.write(folder).write_bytes(content)
    started = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = _looked_at(form.open(folder))
    except (DataError, ConfigError) as error:
        text = str(error)
        result = "refused" if "\n" not in text and str(folder) in text else f"says badly: {text}"
    except MemoryError:
        result = "memory error"
    except Exception as error:
        result = f"traceback: {type(error).__name__}: {error}"
    return "hang" if time.perf_counter() - started > SLOW else result


def _looked_at(dataset: Dataset) -> str:
    points = 0
    for scan in dataset:
        size = np.abs(scan.points)
        if not np.isfinite(size).all() or (size > ABSURD).any():
            return f"absurd: {size.max():g} m"
        if ((size > 0) & (size < SMALLEST)).any():
            return "absurd: denormal"
        for pose in (scan.odometry, scan.ground_truth):
            if pose is not None and not (np.abs(pose) < 1e8).all():
                return f"absurd pose: {pose[:3, 3]}"
        if not abs(scan.stamp) < 1e12:
            return f"absurd stamp: {scan.stamp}"
        points += len(scan.points)
    known = points + sum(getattr(dataset, "dropped", dict)().values())
    if isinstance(dataset, Carmen):
        expected = dataset.angles.size * len(dataset)
    else:
        expected = POINTS * len(dataset)
    if known < expected and not _fewer_announced(dataset):
        return f"uncounted: {known} of {expected} points"
    return "read"


def _fewer_announced(dataset: Dataset) -> bool:
    """Whole records that are gone from files without a header are gone without a trace."""
    files = getattr(dataset, "files", None) or [f.file for f in getattr(dataset, "frames", [])]
    return any(f.suffix in (".bin", ".xyz") for f in files)
