"""A data set: scans by number, checked when it is opened."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.types import Scan
from rbtm_bench.datasets.base import Dataset


class NewDataset(Dataset):
    """A folder of arrays (N, 3) in m (.npy), a file a scan, in the order of their names."""

    planar = False  # True: all points lie in z = 0

    def __init__(self, path: str, rate_hz: float = 10.0) -> None:
        self.files = sorted(Path(path).expanduser().glob("*.npy"))
        self.rate_hz = rate_hz
        if not self.files:
            raise DataError(f"{path}: no .npy file there")
        for file in self.files:
            try:
                shape = np.load(file, mmap_mode="r").shape
            except (OSError, ValueError) as error:
                raise DataError(f"{file}: cannot be read: {error}") from error
            if len(shape) != 2 or shape[1] != 3:
                raise DataError(f"{file}: {shape}: expected points (N, 3)")

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, index: int) -> Scan:
        """Scan ``index``, the same every time; with ``odometry=`` and ``ground_truth=`` (4, 4)
        where they are known (and ``has_odometry``, ``has_ground_truth`` = True)."""
        if not 0 <= index < len(self):
            raise IndexError(f"scan {index} of {len(self)}")
        points = np.load(self.files[index]).astype(np.float64)
        return Scan(index, index / self.rate_hz, points, self.planar)

    def fingerprint(self) -> str:
        """A digest of all that determines the scans."""
        digest = hashlib.sha256(f"{self.rate_hz}".encode())
        for file in self.files:
            digest.update(file.read_bytes())
        return digest.hexdigest()
