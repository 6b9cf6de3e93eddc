"""What a data set is: scans by index, and what is known beside them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

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


class Drops:
    """Points or readings left out of scans, by cause; a scan that is read twice counts once."""

    def __init__(self) -> None:
        self._of_scan: dict[int, dict[str, int]] = {}

    def note(self, scan: int, **causes: Any) -> None:
        """Say how many of a scan were left out; ``_`` in a cause stands for a blank."""
        self._of_scan[scan] = {c.replace("_", " "): int(n) for c, n in causes.items() if n}

    def total(self) -> dict[str, int]:
        """Counts over all scans read so far."""
        total: Counter[str] = Counter()
        for causes in self._of_scan.values():
            total.update(causes)
        return dict(sorted(total.items()))


@dataclass(frozen=True)
class Reading:
    """How something in the data is read, decided from ``why``; ``setting`` says otherwise."""

    what: str
    taken: str
    why: str
    setting: str

    def __str__(self) -> str:
        words = [self.why, f"else {self.setting}=" if self.setting else ""]
        aside = "; ".join(filter(None, words))
        return f"{self.what}: {self.taken}" + (f" ({aside})" if aside else "")


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
    truth_is_exact: bool = False
    """True of simulations alone: poses of a log have errors of their own."""
    skipped: int = 0
    """Records that were malformed and left out (``on_error=skip``)."""
    scored_from: int = 0
    """The first scan that is evaluated: replicates begin at different scans of one drive."""
    draw: dict[str, Any] | None = None
    """What a perturbed copy of a data set has been given (``perturbed``), for ``run.json``."""
    readings: tuple[Reading, ...] = ()
    """What was decided about the data from the data itself."""
    suspicions: tuple[str, ...] = ()
    """What looks wrong with the data, a line each."""

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

    def dropped(self) -> dict[str, int]:
        """Points or readings of the scans read so far that are in no scan, by cause."""
        return {}

    @property
    def relations(self) -> Relations | None:
        """Reference relations, or None."""
        return None


ATTRIBUTES = (
    "planar",
    "has_beams",
    "has_odometry",
    "has_ground_truth",
    "truth_is_exact",
    "skipped",
    "scored_from",
    "draw",
    "readings",
    "suspicions",
    "dropped",
)
"""What a data set that wraps another takes over from it."""


def beam_points(ranges: Array, angles: Array) -> Array:
    """Points (N, 3) in z = 0 of the beams (B,) with a finite range (m) at angles (rad)."""
    hit = np.isfinite(ranges)
    r, a = ranges[hit], angles[hit]
    return np.column_stack([r * np.cos(a), r * np.sin(a), np.zeros(len(r))])
