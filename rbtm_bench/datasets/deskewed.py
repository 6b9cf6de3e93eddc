"""Clouds without the motion of the sensor within a sweep: every point as seen at the scan's stamp.

The motion during a sweep is the last one between scans, as in KISS-ICP (Vizzo et al. 2023): by
odometry where there is any, else found by KISS-ICP itself, so that scans stay what they are
whichever way they are registered later.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import expm, logm

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.geometry import inverse, transform
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import ATTRIBUTES, Dataset, Reading, Relations

VERSION = "deskewed-1"
"""Part of the fingerprint."""
REACH = 100.0
"""m, KISS-ICP's own default, which its voxels are sized by; shorter where the first scan is."""
ALL = 1e9
"""m; the library drops what is farther, and nothing is."""


class Deskewed(Dataset):
    """A data set whose clouds carry times within the scan, brought to each scan's stamp.

    ``kiss_icp.preprocess.Preprocessor`` moves the points by the last motion known when the scan
    comes: odometry's from the scan before, or without odometry that of
    ``kiss_icp.kiss_icp.KissICP`` before it, which runs over the scans in order, as far as they are
    asked for, in one thread. Scans that come before any motion is known are given the first one:
    left as they are they would shift all that follows. Raises ``ConfigError`` for planar data.
    """

    def __init__(self, plain: Dataset) -> None:
        if plain.planar:
            raise ConfigError("deskew=true: for clouds, these are planar scans")
        self.plain = plain
        for name in ATTRIBUTES:
            setattr(self, name, getattr(plain, name))
        first = plain[0]
        self.applies = first.times is not None and float(np.ptp(first.times)) > 0.0
        why = "points have times within the scan" if self.applies else "no times within scans"
        by = "odometry" if plain.has_odometry else "KISS-ICP"
        taken = f"by the last motion of {by}, to the stamp" if self.applies else "does not apply"
        self.readings = (*plain.readings, Reading("deskew", taken, why, "deskew"))
        self._motions: list[Array] = [np.eye(4)]
        self._stamps: list[float] = []
        self._kiss: Any = None

    def __len__(self) -> int:
        return len(self.plain)

    def __getitem__(self, index: int) -> Scan:
        scan = self.plain[index]
        if not self.applies or scan.times is None or len(scan.points) == 0:
            return scan
        motion, step = self._by_odometry(scan) if self.has_odometry else self._before(index)
        if step <= 0.0 or np.ptp(scan.times) == 0.0:
            return replace(scan, times=None)
        velocity = logm(motion).real / step
        span = float(np.ptp(scan.times))
        at_end = self._moved(scan.points, scan.times, expm(span * velocity))
        points = transform(expm(float(scan.times.max()) * velocity), at_end)
        return replace(scan, points=points, times=None)

    def fingerprint(self) -> str:
        """sha256 of the data set's own and of how it is deskewed; its own where that does not
        apply."""
        own = self.plain.fingerprint()
        if not self.applies:
            return own
        return hashlib.sha256(f"{VERSION} {own}".encode()).hexdigest()

    @property
    def relations(self) -> Relations | None:
        """The data set's own."""
        return self.plain.relations

    def _by_odometry(self, scan: Scan) -> tuple[Array, float]:
        """Odometry's motion from the scan before, T_before_scan, and the s that it took."""
        if len(self) < 2:
            return np.eye(4), 0.0
        last = max(scan.index, 1)
        a, b = self.plain[last - 1], self.plain[last]
        assert a.odometry is not None and b.odometry is not None
        return inverse(a.odometry) @ b.odometry, b.stamp - a.stamp

    def _before(self, index: int) -> tuple[Array, float]:
        """The last motion known when a scan comes, T_before_last, and the s that it took."""
        index = max(index, min(2, len(self)))
        while len(self._stamps) < index:
            scan = self.plain[len(self._stamps)]
            self._register(scan)
            self._stamps.append(scan.stamp)
        step = self._stamps[index - 1] - self._stamps[index - 2] if index > 1 else 0.0
        return self._motions[index], step

    def _register(self, scan: Scan) -> None:
        if self._kiss is None:
            distance = np.linalg.norm(scan.points, axis=1)
            self._kiss = _pipeline(min(REACH, float(distance.max())))
        times = np.zeros(len(scan.points)) if scan.times is None else scan.times
        self._kiss.register_frame(scan.points, times)
        self._motions.append(np.array(self._kiss.last_delta))

    @staticmethod
    def _moved(points: Array, times: Array, motion: Array) -> Array:
        """Points as seen at the last of the times, ``motion`` being that from the first to it."""
        from kiss_icp.preprocess import Preprocessor

        moved = Preprocessor(ALL, 0.0, True, 1).preprocess(points, times, motion)
        assert len(moved) == len(points)
        return np.asarray(moved, dtype=np.float64)


def _pipeline(reach: float) -> Any:
    """KISS-ICP with its defaults, scaled from 100 m to ``reach`` (m)."""
    from kiss_icp.config import KISSConfig
    from kiss_icp.config.config import (
        AdaptiveThresholdConfig,
        DataConfig,
        MappingConfig,
        RegistrationConfig,
    )
    from kiss_icp.kiss_icp import KissICP

    share = reach / REACH
    threshold = {"initial_threshold": 2.0 * share, "min_motion_th": 0.1 * share}
    return KissICP(
        KISSConfig(
            out_dir="",
            data=DataConfig(max_range=10.0 * reach, min_range=0.0, deskew=True),
            mapping=MappingConfig(voxel_size=share, max_points_per_voxel=20),
            registration=RegistrationConfig(
                max_num_iterations=500, convergence_criterion=1e-4, max_num_threads=1
            ),
            adaptive_threshold=AdaptiveThresholdConfig(fixed_threshold=None, **threshold),
        )
    )


def deskewed(plain: Dataset, asked: bool) -> Dataset:
    """The data set itself where that is not asked for."""
    return Deskewed(plain) if asked else plain
