"""What a data set is: scans by index, and what is known beside them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
    scored_from: int = 0
    """The first scan that is evaluated: replicates begin at different scans of one drive."""
    draw: dict[str, Any] | None = None
    """What a perturbed copy of a data set has been given (``perturbed``), for ``run.json``."""

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


ATTRIBUTES = (
    "planar",
    "has_beams",
    "has_odometry",
    "has_ground_truth",
    "skipped",
    "scored_from",
    "draw",
)
"""What a data set that wraps another takes over from it."""


def beam_points(ranges: Array, angles: Array) -> Array:
    """Points (N, 3) in z = 0 of the beams (B,) with a finite range (m) at angles (rad)."""
    hit = np.isfinite(ranges)
    r, a = ranges[hit], angles[hit]
    return np.column_stack([r * np.cos(a), r * np.sin(a), np.zeros(len(r))])


def nearest(stamps: Array, times: Array, tolerance_s: float) -> NDArray[np.intp]:
    """Index (R,) of the stamp (N,) nearest to each time (R,), -1 if none is within tolerance.

    ``stamps`` (s) in any order; of several equally near the earlier, then the first, is taken.
    """
    missing = np.full(len(times), -1, dtype=np.intp)
    if len(stamps) == 0:
        return missing
    order = np.argsort(stamps, kind="stable")
    ordered = stamps[order]
    after = np.searchsorted(ordered, times).clip(max=len(stamps) - 1)
    before = (after - 1).clip(min=0)
    # Equal stamps sort as they came: step to the first of those before.
    before = np.searchsorted(ordered, ordered[before])
    best = np.where(
        np.abs(ordered[before] - times) <= np.abs(ordered[after] - times), before, after
    )
    return np.where(np.abs(ordered[best] - times) <= tolerance_s, order[best], missing)
