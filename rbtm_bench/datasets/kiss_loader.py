"""KISS-ICP's data loaders as our data sets: what they print or exit with becomes our errors.

A format needs a subclass that checks its files first, so that a message can name the one at fault,
and hands the opened loader over; ``kitti.py`` is the pattern.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.geometry import is_rigid
from rbtm_bench.core.trajectory import orthonormalised
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import Dataset, Drops
from rbtm_bench.datasets.cloud_files import usable
from rbtm_bench.datasets.files import reader

VERSION = "kiss-loader-1"
"""Part of the fingerprint: change it whenever the same files and settings give other scans."""

POSE_TOLERANCE = 1e-3
"""How far from orthonormal a loader's rotations may be: some files have six digits."""


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
    except Exception as error:
        text = " ".join(f"{type(error).__name__}: {error}".split())
    raise DataError(f"{path}: KISS-ICP's loader {name} cannot read it: {text}")


class KissDataset(Dataset):
    """The frames of a loader, a scan each; times within a scan are not used.

    ``settings`` are those that change the scans, for the fingerprint. ``truth`` (M, 4, 4) holds
    the loader's poses T_world_sensor by frame number, None if it has none; only the frames from
    the first to the last of ``truth_frames`` (all by default) get them. Points that are not
    finite, implausible, not farther than ``min_range`` (m) or not nearer than ``max_range`` (m)
    are dropped and counted.
    Raises ``DataError`` for a pose that is no rigid motion, and at ``dataset[i]`` for a scan
    that cannot be read or has no point left.
    """

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
            known = [frame for frame in frames if first <= frame.number <= last]
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
        return Scan(index, frame.stamp, self._points(index), ground_truth=truth)

    def fingerprint(self) -> str:
        """sha256 of the scans' files, stamps, truth and settings; reads every file once."""
        if self._fingerprint is None:
            digest = hashlib.sha256(repr(self._settings).encode())
            for frame in self.frames:
                truth = self.ground_truth.get(frame.number)
                digest.update(np.float64(frame.stamp).tobytes())
                digest.update(b"no truth" if truth is None else truth.tobytes())
                digest.update(_file_digest(frame.file))
            self._fingerprint = digest.hexdigest()
        return self._fingerprint

    def _points(self, index: int) -> Array:
        frame = self.frames[index]
        read, _ = quietly(self._name, frame.file, lambda: self._loader[frame.position])
        points = np.asarray(read, dtype=np.float64)
        kept, causes = usable(frame.file, points, self.min_range, self.max_range)
        self._drops.note(index, **causes)
        return kept

    def dropped(self) -> dict[str, int]:
        return self._drops.total()


def _rigid(T: Array, frame: Frame) -> Array:
    if not is_rigid(T, POSE_TOLERANCE):
        raise DataError(f"the ground truth of frame {frame.number} is no rigid motion")
    return orthonormalised(np.asarray(T, dtype=np.float64))


@reader
def _file_digest(file: Path) -> bytes:
    with open(file, "rb") as content:
        return hashlib.file_digest(content, "sha256").digest()
