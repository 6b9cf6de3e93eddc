"""What a data set is: scans by index, and what is known beside them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rbtm_bench.core.types import Array, Scan


@dataclass(frozen=True, eq=False)
class Relations:
    """Relative poses known between pairs of times (Kuemmerle et al. 2009).

    ``start`` and ``end`` (R,) s; ``T_start_end`` (R, 4, 4) the reference motion.
    """

    start: Array
    end: Array
    T_start_end: Array

    def __len__(self) -> int:
        return len(self.start)


class Dataset(ABC):
    """A sequence of scans, validated when it is opened, read one scan at a time.

    Constructors open and check their files: a bad file raises ``DataError`` before any run
    starts. ``len(dataset)`` scans; ``dataset[i]`` gives ``Scan`` i (0 <= i < len), every time the
    same. The ``has_*`` and ``planar`` attributes hold for every scan, except that with
    ``has_ground_truth`` some scans may lack a truth (None): it is not known, and metrics skip them.
    """

    planar: bool = False
    has_beams: bool = False
    has_odometry: bool = False
    has_ground_truth: bool = False
    skipped: int = 0
    """Records that were malformed and left out (``on_error=skip``)."""

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def __getitem__(self, index: int) -> Scan: ...

    def __iter__(self) -> Iterator[Scan]:
        for index in range(len(self)):
            yield self[index]

    @abstractmethod
    def fingerprint(self) -> str:
        """A hex digest of everything that determines the scans: file bytes and settings."""

    @property
    def relations(self) -> Relations | None:
        """Reference relations, or None."""
        return None


def beam_points(ranges: Array, angles: Array) -> Array:
    """Points (N, 3) in z = 0 of the beams (B,) with a finite range (m) at angles (rad)."""
    hit = np.isfinite(ranges)
    r, a = ranges[hit], angles[hit]
    return np.column_stack([r * np.cos(a), r * np.sin(a), np.zeros(len(r))])
