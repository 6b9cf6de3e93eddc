"""KISS-ICP's data loaders as our data sets: what they print or exit with becomes our errors.

``KissFormat`` is the data set of most of them, by what ``kiss_formats`` knows of each; KITTI's
odometry data have a class of their own, which checks its files first (``kitti.py``).
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import io
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt, Le

from rbtm_bench.core.errors import ConfigError, DataError, RbtmBenchError
from rbtm_bench.core.geometry import is_rigid
from rbtm_bench.core.trajectory import orthonormalised
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.association import time_suspicions
from rbtm_bench.datasets.base import Dataset, Drops, Reading
from rbtm_bench.datasets.cloud_files import returns
from rbtm_bench.datasets.files import file_size, reader
from rbtm_bench.datasets.kiss_formats import FORMATS

VERSION = "kiss-loader-1"
"""Part of the fingerprint: change it whenever the same files and settings give other scans."""

POSE_TOLERANCE = 1e-3
"""How far from orthonormal a loader's rotations may be: some files have six digits."""


Index = Annotated[int, Ge(0), Le(9999)]


@dataclass(frozen=True)
class Frame:
    """One scan of a loader: its ``number`` in the data set's own count, its ``position`` in the
    loader, its file, and its time in s."""

    number: int
    position: int
    file: Path
    stamp: float


def open_loader(name: str, path: str | Path, **arguments: Any) -> Any:
    """KISS-ICP's loader ``name`` on the data at ``path``.

    Raises ``ConfigError`` if a package that the loader needs is missing, ``DataError`` for
    whatever else it raises, or prints before it exits.
    """
    from kiss_icp.datasets import dataset_factory

    return quietly(name, path, lambda: dataset_factory(name, Path(path), **arguments))


def quietly(name: str, path: str | Path, ask: Callable[[], Any]) -> Any:
    """What ``ask`` answers, without what it prints; its errors and exits as ours."""
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return ask()
    except ImportError as error:
        raise ConfigError(f"KISS-ICP's loader {name} needs a package: {error}") from error
    except SystemExit as error:
        text = " ".join(printed.getvalue().split()) or f"it exited with {error.code}"
    except RbtmBenchError:
        raise
    except Exception as error:
        text = " ".join(f"{type(error).__name__}: {error}".split())
    raise DataError(f"{path}: KISS-ICP's loader {name} cannot read it: {text}")


class KissDataset(Dataset):
    """The frames of a loader, a scan each; of points that have times within the sweep these are
    kept where it is known how long it takes (``sweep_s``, s).

    ``settings`` are those that change the scans, for the fingerprint. ``truth`` (M, 4, 4) holds
    the loader's poses T_world_sensor by frame number, all NaN where unknown, None if it has none;
    only the frames from
    the first to the last of ``truth_frames`` (all by default) get them. Points that are not
    finite, implausible, not farther than ``min_range`` (m) or not nearer than ``max_range`` (m)
    are dropped and counted.
    Raises ``DataError`` for a pose that is no rigid motion, and at ``dataset[i]`` for a scan
    that cannot be read or has no point left.
    """

    sweep_s = 0.0

    def __init__(
        self,
        name: str,
        loader: Any,
        frames: Sequence[Frame],
        settings: Sequence[Any],
        truth: Array | None = None,
        truth_frames: tuple[int, int] | None = None,
        min_range: float = 0.0,
        max_range: float | None = None,
    ) -> None:
        self.frames = frames
        self.min_range = float(min_range)
        self.max_range = np.inf if max_range is None else float(max_range)
        first, last = truth_frames or (0, frames[-1].number)
        self.ground_truth: dict[int, Array] = {}
        if truth is not None:
            known = [
                frame
                for frame in frames
                if first <= frame.number <= last and not np.isnan(truth[frame.number]).all()
            ]
            self.ground_truth = {f.number: _rigid(truth[f.number], f) for f in known}
        self.has_ground_truth = bool(self.ground_truth)
        self._name, self._loader = name, loader
        self._settings = [VERSION, name, self.min_range, self.max_range, *settings]
        self._drops = Drops()
        self._fingerprint: str | None = None

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> Scan:
        if not 0 <= index < len(self):
            raise IndexError(f"scan {index} of {len(self)}")
        frame = self.frames[index]
        truth = self.ground_truth.get(frame.number)
        points, share = self._read(frame)
        kept, causes = returns(frame.file, points, self.min_range, self.max_range)
        self._drops.note(index, **causes)
        times = None if share is None or not self.sweep_s else self.sweep_s * share[kept]
        return Scan(index, frame.stamp, points[kept], ground_truth=truth, times=times)

    def fingerprint(self) -> str:
        """sha256 of the scans' files, stamps, truth and settings; reads every file once."""
        if self._fingerprint is None:
            digest = hashlib.sha256(repr(self._settings).encode())
            digests = {file: _file_digest(file) for file in {f.file for f in self.frames}}
            for frame in self.frames:
                truth = self.ground_truth.get(frame.number)
                digest.update(np.float64(frame.stamp).tobytes())
                digest.update(b"no truth" if truth is None else truth.tobytes())
                digest.update(digests[frame.file])
            self._fingerprint = digest.hexdigest()
        return self._fingerprint

    def _read(self, frame: Frame) -> tuple[Array, Array | None]:
        """All points (N, 3) of a frame, and when in its sweep (0 to 1) each (N,) was taken."""
        read, share = quietly(self._name, frame.file, lambda: self._loader[frame.position])
        points = np.asarray(read, dtype=np.float64)
        share = np.asarray(share, dtype=np.float64).ravel()
        known = len(share) == len(points) and bool(((share >= 0) & (share <= 1)).all())
        return points, share if known else None

    def dropped(self) -> dict[str, int]:
        return self._drops.total()


Loader = Literal[
    "apollo",
    "boreas",
    "generic",
    "helipr",
    "kitti_raw",
    "mulran",
    "ncd",
    "nclt",
    "nuscenes",
    "ouster",
    "tum",
]
"""Loaders of KISS-ICP's that need no vendor's kit, and two that do."""


class KissFormat(KissDataset):
    """A data set by KISS-ICP's ``loader``: apollo, boreas, generic, helipr, kitti_raw, mulran,
    ncd (Newer College), nclt, nuscenes, ouster (one .pcap file) or tum.

    ``path`` is the folder that the loader expects (docs/data.md); ``sequence`` a part of it, for
    helipr (Avia, Aeva, Ouster, Velodyne), kitti_raw (00 to 10) and nuscenes (a scene's number).
    Times are those of the files' names or of a table beside them, else scans are 1 / ``rate_hz`` s
    apart, which is said. A truth that belongs to scans by time is within ``tolerance_s`` (s) of
    them, or not known.
    ``min_range``, ``max_range`` in m; ``stride`` keeps every n-th scan, then ``max_scans`` the
    first so many. Points are read anew where the loader is known to err (``kiss_formats``).

    Raises ``ConfigError`` for a missing package or sequence, ``DataError`` for data that the loader
    cannot read, or that do not belong together.
    """

    def __init__(
        self,
        path: str,
        loader: Loader,
        sequence: Literal["Avia", "Aeva", "Ouster", "Velodyne"] | Index | None = None,
        rate_hz: Annotated[float, Gt(0)] = 10.0,
        tolerance_s: Annotated[float, Gt(0)] = 0.1,
        stride: Annotated[int, Ge(1)] = 1,
        max_scans: Annotated[int, Ge(1)] | None = None,
        min_range: Annotated[float, Ge(0)] = 0.0,
        max_range: Annotated[float, Gt(0)] | None = None,
    ) -> None:
        form, folder = FORMATS[loader], Path(path).absolute()
        if form.sequence and sequence is None:
            raise ConfigError(f"{path}: dataset.sequence= says which sequence {loader} reads")
        if form.module and importlib.util.find_spec(form.module) is None:
            raise ConfigError(f"dataset={loader} needs {form.package}: pip install {form.package}")
        if form.one_file:
            file_size(folder)
        elif not folder.is_dir():
            raise DataError(f"{path}: expected the folder of a data set")
        named = {"sequence": str(sequence)} if form.sequence else {}
        opened = open_loader(loader, folder, **named)
        files = quietly(loader, path, lambda: form.files(folder, opened))
        if not files:
            raise DataError(f"{path}: KISS-ICP's loader {loader} found no scan")
        for file in files:
            file_size(file)
        stamps = quietly(loader, path, lambda: form.times(folder, opened, files))
        truth = quietly(loader, path, lambda: form.truth(folder, opened, stamps, tolerance_s))
        for what, known in (("times", stamps), ("poses of the truth", truth)):
            if known is not None and len(known) != len(files):
                raise DataError(f"{path}: {len(known)} {what} for {len(files)} scans")
        assumed = stamps is None
        stamps = np.arange(len(files)) / rate_hz if assumed else stamps
        every = [Frame(i, i, file, float(stamps[i])) for i, file in enumerate(files)]
        self._own_points = form.points
        settings = [str(sequence), *([rate_hz] if assumed else [])]
        frames = every[::stride][:max_scans]
        if truth is not None:
            truth = np.where(np.isfinite(truth).all(axis=(1, 2))[:, None, None], truth, np.nan)
        super().__init__(loader, opened, frames, settings, truth, None, min_range, max_range)
        self.stamps = np.array([frame.stamp for frame in frames])
        if len(stamps) > 1:
            self.sweep_s = max(0.0, float(np.median(np.diff(stamps))))
        taken = f"{rate_hz:g} Hz from 0 s" if assumed else "those of the data set"
        self.readings = (
            Reading("times", taken, "no times were found" if assumed else "", "rate_hz"),
            Reading("truth", f"{len(self.ground_truth)} of {len(frames)} scans", "", ""),
        )
        self.suspicions = tuple(time_suspicions(self.stamps))

    def _read(self, frame: Frame) -> tuple[Array, Array | None]:
        own = self._own_points
        if own is None:
            return super()._read(frame)
        read = quietly(self._name, frame.file, lambda: own(frame.file, self._loader))
        return np.asarray(read), None


def _rigid(T: Array, frame: Frame) -> Array:
    if not is_rigid(T, POSE_TOLERANCE):
        raise DataError(f"the ground truth of frame {frame.number} is no rigid motion")
    return orthonormalised(np.asarray(T, dtype=np.float64))


@reader
def _file_digest(file: Path) -> bytes:
    with open(file, "rb") as content:
        return hashlib.file_digest(content, "sha256").digest()
