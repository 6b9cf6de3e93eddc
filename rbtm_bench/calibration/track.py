"""What is known of every scan of a data set without looking at its points twice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.geometry import inverse, translation_norm
from rbtm_bench.core.trajectory import Mask
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.base import Dataset, Relations

LOOKED_AT = 50
"""Scans whose points are looked at for ``reach``."""


@dataclass(frozen=True, eq=False)
class Track:
    """Stamps (N,) s and poses (N, 4, 4) of a data set's scans, NaN for a pose that is not known.

    ``odometry`` and ``truth`` are None where the data set has none. ``reach`` (m): the median
    distance of what scans see; two scans further apart than this share little.
    """

    stamps: Array
    odometry: Array | None
    truth: Array | None
    reach: float
    planar: bool
    relations: Relations | None
    exact: bool = False
    """Whether the truth is that of a simulation."""

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def path(self) -> Array | None:
        """The poses that distances are taken from: odometry, else the truth."""
        return self.truth if self.odometry is None else self.odometry

    @property
    def known(self) -> Mask:
        """(N,) whether a scan's true pose is known."""
        if self.truth is None:
            return np.zeros(len(self), bool)
        return np.asarray(np.isfinite(self.truth[:, 0, 3]))

    def travelled(self) -> Array | None:
        """Metres (N,) travelled since the first scan; None without poses. Over scans without a
        pose nothing is added."""
        return None if self.path is None else travelled(self.path)


def travelled(poses: Array) -> Array:
    """The length (N,) in m of the path through the poses (N, 4, 4), 0 at the first."""
    steps = translation_norm(inverse(poses[:-1]) @ poses[1:])
    return np.concatenate([[0.0], np.cumsum(np.nan_to_num(steps))])


def track_of(dataset: Dataset, progress: Callable[[int, int], None] | None = None) -> Track:
    """Read every scan once."""
    count = len(dataset)
    stamps = np.full(count, np.nan)
    odometry = np.full((count, 4, 4), np.nan)
    truth = np.full((count, 4, 4), np.nan)
    looked_at = set(np.linspace(0, count - 1, min(count, LOOKED_AT)).astype(int).tolist())
    ranges: list[NDArray[np.float64]] = []
    for i, scan in enumerate(dataset):
        stamps[i] = scan.stamp
        if scan.odometry is not None:
            odometry[i] = scan.odometry
        if scan.ground_truth is not None:
            truth[i] = scan.ground_truth
        if i in looked_at and len(scan.points):
            ranges.append(np.linalg.norm(scan.points, axis=1))
        if progress:
            progress(i + 1, count)
    return Track(
        stamps,
        odometry if dataset.has_odometry else None,
        truth if dataset.has_ground_truth else None,
        float(np.median(np.concatenate(ranges))) if ranges else 0.0,
        dataset.planar,
        dataset.relations,
        dataset.truth_is_exact,
    )
