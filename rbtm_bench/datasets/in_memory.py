"""Scans that no file holds: arrays and clouds of whoever calls from Python."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.types import Scan
from rbtm_bench.datasets.base import Dataset


class FirstScan(Dataset):
    """As much of a stream as is known before it is read: its first scan."""

    def __init__(self, scan: Scan) -> None:
        self.scan = scan
        self.planar, self.has_beams = scan.planar, scan.ranges is not None
        self.has_odometry = scan.odometry is not None
        self.has_ground_truth = scan.ground_truth is not None

    def __len__(self) -> int:
        return 1

    def __getitem__(self, index: int) -> Scan:
        return self.scan

    def fingerprint(self) -> str:
        return ""


def scan_of(given: Any, index: int) -> Scan:
    """A cloud as a scan. Raises ``DataError`` for what is none."""
    if isinstance(given, Scan):
        return given
    try:
        points = np.array(getattr(given, "points", given), dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise DataError(f"scan {index}: no array of numbers: {error}") from None
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise DataError(f"scan {index}: {points.shape}: expected points (N, 2) or (N, 3)")
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    planar = len(points) > 0 and not points[:, 2].any()
    return Scan(index, float(index), points, planar)


def numbered(scans: Iterable[Any]) -> Iterator[Scan]:
    """The scans, all in the plane or all in space, with numbers that grow."""
    first = last = None
    for position, given in enumerate(scans):
        scan = scan_of(given, position)
        if last is not None and scan.index <= last:
            raise DataError(f"scan {scan.index} comes after {last}: expected numbers that grow")
        first = scan if first is None else first
        if len(scan.points) and scan.planar is not first.planar:
            raise DataError(
                f"scan {scan.index} is {'' if scan.planar else 'not '}planar; the "
                f"first one is{'' if first.planar else ' not'}"
            )
        last = scan.index
        yield scan if len(scan.points) else replace(scan, planar=first.planar)
