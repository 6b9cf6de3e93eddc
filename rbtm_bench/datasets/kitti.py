"""KITTI's odometry data (Geiger, Lenz and Urtasun 2012), read by KISS-ICP's loader."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.geometry import inverse, is_rigid, se3
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.association import time_suspicions
from rbtm_bench.datasets.base import Reading
from rbtm_bench.datasets.cloud_files import check_file
from rbtm_bench.datasets.files import data_lines, read_bytes, to_numbers
from rbtm_bench.datasets.kiss_loader import Frame, KissDataset, quietly
from rbtm_bench.datasets.poses_file import KITTI_COLUMNS, read_poses

CALIBRATION_TOLERANCE = 1e-3
"""How far Tr's rotation may be from an exact one."""

ALIKE_STEPS, ALIKE, ALIKE_DEG = 8, 0.003, 0.005
"""So many steps whose lengths (share) and turns are so much alike are no car's."""

Index = Annotated[int, Ge(0)]


class Kitti(KissDataset):
    """A sequence in KITTI's layout: ``path``/sequences/00/velodyne/000000.bin with calib.txt and
    times.txt beside it. Poses, if there are any, are in ``path``/poses/00.txt
    (KITTI's own layout) or ``path``/sequences/00/poses.txt (SemanticKITTI's).

    A frame's number is its file's name: a folder may hold any of a sequence's frames, with times
    and poses of all. The official poses are the left camera's; KISS-ICP's loader brings them into
    the laser's frame by Tr (calib.txt). Where they are not to be trusted over the whole sequence,
    ``ground_truth_frames`` [first, last] keeps those of these frames alone.

    ``correct_scans``: turn every point up by 0.205 deg as seen from the sensor, the error of
    KITTI's vertical calibration that KISS-ICP (like IMLS-SLAM and CT-ICP before it) corrects.
    ``stride`` keeps every n-th frame, then ``max_scans`` the first so many; ``min_range`` and
    ``max_range`` in m. Scans are used as they come, compensated for the motion by KITTI.

    Raises ``DataError`` naming the file that is missing or malformed, ``ConfigError`` for
    ``ground_truth_frames`` that end before they begin.
    """

    def __init__(
        self,
        path: str,
        sequence: Index = 0,
        correct_scans: bool = True,
        ground_truth_frames: tuple[Index, Index] | None = None,
        stride: Annotated[int, Ge(1)] = 1,
        max_scans: Annotated[int, Ge(1)] | None = None,
        min_range: Annotated[float, Ge(0)] = 0.0,
        max_range: Annotated[float, Gt(0)] | None = None,
    ) -> None:
        if ground_truth_frames and ground_truth_frames[0] > ground_truth_frames[1]:
            first, last = ground_truth_frames
            raise ConfigError(f"dataset.ground_truth_frames=[{first},{last}]: expected first, last")
        name = f"{sequence:02d}"
        folder = _sequence_folder(Path(path), name)
        scans = _scan_files(folder / "velodyne")
        Tr = _calibration(folder / "calib.txt")
        stamps = _read_times(folder / "times.txt")
        last = scans[-1][0]
        _require(folder / "times.txt", len(stamps), "times", last)
        poses = _poses_file(Path(path), folder, name)
        truth = None if poses is None else _laser_poses(poses, Tr)
        if poses is not None and truth is not None:
            _require(poses, len(truth), "poses", last)
        loader = _open(path, name, correct_scans)
        frames = [
            Frame(number, position, file, stamps[number])
            for position, (number, file) in enumerate(scans)
        ][::stride][:max_scans]
        super().__init__(
            "kitti",
            loader,
            frames,
            [correct_scans],
            truth,
            ground_truth_frames,
            min_range,
            max_range,
        )
        what = "none" if poses is None else f"{poses}, by Tr in the laser's frame"
        self.readings = (Reading("truth", what, "" if poses else "no file of poses", ""),)
        self.suspicions = tuple(time_suspicions(np.array([frame.stamp for frame in frames])))
        if truth is not None and self.ground_truth:
            self.suspicions += _extrapolated(truth, min(self.ground_truth), max(self.ground_truth))


def _open(path: str, name: str, correct_scans: bool) -> Any:
    """KISS-ICP's loader, but for its poses, which it would only find in one place."""

    def make() -> Any:
        from kiss_icp.datasets.kitti import KITTIOdometryDataset

        class Loader(KITTIOdometryDataset):  # type: ignore[misc]
            def load_poses(self, poses_file: str) -> None:
                return None

        return Loader(path, sequence=name)

    loader = quietly("kitti", path, make)
    if not correct_scans:
        loader.correct_kitti_scan = _as_it_is
    return loader


def _poses_file(path: Path, folder: Path, name: str) -> Path | None:
    """KITTI's own place for the poses, or SemanticKITTI's; None if there are none."""
    places = (path / "poses" / f"{name}.txt", folder / "poses.txt")
    return next((place for place in places if place.is_file()), None)


def _laser_poses(path: Path, Tr: Array) -> Array:
    """The poses of the left camera as those of the laser, with KISS-ICP's own arithmetic."""
    read_poses(path)  # says what is wrong, and where
    rows = [to_numbers(path, line, "pose", words) for line, words in data_lines(read_bytes(path))]
    if len(rows[0]) != KITTI_COLUMNS:
        raise DataError(f"{path}: expected 12 numbers a pose, found {len(rows[0])}")
    camera = np.tile(np.eye(4), (len(rows), 1, 1))
    camera[:, :3] = np.array(rows).reshape(-1, 3, 4)
    left = np.einsum("...ij,...jk->...ik", np.linalg.inv(Tr), camera)
    return np.asarray(np.einsum("...ij,...jk->...ik", left, Tr))


def _extrapolated(truth: Array, first: int, last: int) -> tuple[str, ...]:
    """A word on poses (N, 4, 4) that begin, from frame ``first`` on, with steps too much alike to
    have been measured."""
    T = truth[first : last + 1]
    if len(T) < ALIKE_STEPS + 1:
        return ()
    steps = inverse(T[:-1]) @ T[1:]
    lengths = np.linalg.norm(steps[:, :3, 3], axis=1)
    turns = np.degrees(np.arctan2(steps[:, 1, 0], steps[:, 0, 0]))
    odd = np.abs(lengths - lengths[0]) > ALIKE * lengths[0]
    odd |= np.abs(turns - turns[0]) > ALIKE_DEG
    alike = int(np.argmax(odd)) if odd.any() else len(odd)
    if alike < ALIKE_STEPS or lengths[0] == 0:
        return ()
    end = first + alike
    keep = f"; dataset.ground_truth_frames=[{end},{last}] leaves them out" if end < last else ""
    return (
        f"the true poses of frames {first} to {end} make the same step of {lengths[0]:.3f} m, "
        f"{alike} times: extrapolated, not measured{keep}",
    )


def _as_it_is(points: Any) -> Any:
    return points


def _sequence_folder(path: Path, name: str) -> Path:
    sequences = path / "sequences"
    if not sequences.is_dir():
        raise DataError(f"{sequences}: no such folder: expected KITTI's layout, sequences/00/...")
    if not (sequences / name).is_dir():
        names = sorted(place.name for place in sequences.iterdir() if place.is_dir())
        raise DataError(f"{sequences / name}: no such sequence; found {', '.join(names) or 'none'}")
    return sequences / name


def _scan_files(folder: Path) -> list[tuple[int, Path]]:
    """Frame numbers and files, in the order of the loader (that of names); every size checked."""
    if not folder.is_dir():
        raise DataError(f"{folder}: no such folder: expected the scans 000000.bin, 000001.bin, ...")
    files = sorted(file for file in folder.glob("*.bin") if not file.name.startswith("."))
    if not files:
        raise DataError(f"{folder}: no .bin file: expected the scans 000000.bin, 000001.bin, ...")
    for file in files:
        check_file(file)
        if not file.stem.isdecimal():
            raise DataError(f"{file}: expected a frame's number as its name, such as 000000.bin")
    scans = [(int(file.stem), file) for file in files]
    if scans != sorted(scans):
        raise DataError(f"{folder}: expected names of one length, such as 000000.bin")
    return scans


def _calibration(path: Path) -> Array:
    """The motion Tr (4, 4), camera from laser, in single precision as the loader has it."""
    for line, words in data_lines(read_bytes(_existing(path, "the line Tr: and 12 numbers"))):
        if words[0] == b"Tr:":
            values = to_numbers(path, line, "Tr", words[1:])
            if len(values) != 12:
                raise DataError.at(path, line, "Tr", f"12 numbers, {len(values)} found")
            Tr = np.array(values).reshape(3, 4)
            if not is_rigid(se3(Tr[:, 3], Tr[:, :3]), CALIBRATION_TOLERANCE):
                raise DataError.at(path, line, "Tr", "a rigid motion [R t], camera from laser")
            return se3(Tr[:, 3].astype(np.float32), Tr[:, :3].astype(np.float32))
    raise DataError(f"{path}: expected a line Tr: with 12 numbers, the camera from the laser")


def _read_times(path: Path) -> list[float]:
    """Seconds since the first frame, one a line."""
    times = []
    for line, words in data_lines(read_bytes(_existing(path, "the frames' times"))):
        if len(words) != 1:
            raise DataError.at(path, line, "time", f"1 number, {len(words)} found")
        times += to_numbers(path, line, "time", words, largest=1e12)
    return times


def _existing(path: Path, what: str) -> Path:
    if not path.is_file():
        raise DataError(f"{path}: no such file: expected {what}")
    return path


def _require(path: Path, count: int, what: str, last: int) -> None:
    if count <= last:
        raise DataError(f"{path}: {count} {what}, but the last scan is {last:06d}.bin")
