"""What a similarity is: a descriptor a scan, and the scores of a whole window in one call."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.datasets.base import Dataset
from rbtm_bench.errors import ConfigError
from rbtm_bench.types import Array, Scan

Descriptor = NDArray[Any]

BLOCK = 256


class Similarity(ABC):
    """Scores in [-1, 1] of how alike two scans are; NaN where a score is undefined.

    A plug-in writes ``describe`` and ``scores``. Descriptors are 1-D arrays of one length and
    type for a whole data set, so that a window of them is a matrix.
    """

    requires: tuple[str, ...] = ()
    """Names of the Python packages that must be importable."""

    def check(self, dataset: Dataset) -> None:  # noqa: B027 (optional to override)
        """Raise ``ConfigError`` if this similarity cannot read the data set."""

    @abstractmethod
    def describe(self, scan: Scan) -> Descriptor:
        """The descriptor (D,) of a scan."""

    @abstractmethod
    def scores(self, window: Descriptor, descriptor: Descriptor) -> Array:
        """Scores (W,) of the window's descriptors (W, D) against one descriptor (D,)."""

    def pairwise(self, rows: Descriptor, columns: Descriptor) -> Array:
        """Scores (M, K) of descriptors (M, D) against descriptors (K, D)."""
        return np.stack([self.scores(rows, d) for d in columns], axis=1)

    def matrix(self, descriptors: Descriptor) -> Array:
        """Scores (N, N) of all pairs of N descriptors (N, D): Fig. 1(c) of the paper."""
        return self.pairwise(descriptors, descriptors)

    def band(self, descriptors: Descriptor, window: int) -> Array:
        """Scores (N, window - 1) of a whole log: column g - 1 holds S(j, j - g), NaN if g > j.

        Memory: the band, and one block of (256 + window) x 256 scores.
        """
        count = len(descriptors)
        band = np.full((count, window - 1), np.nan)
        gaps = np.arange(1, window)
        for start in range(0, count, BLOCK):
            stop = min(start + BLOCK, count)
            first = max(0, start - window + 1)
            block = self.pairwise(descriptors[first:stop], descriptors[start:stop])
            scan = np.arange(start, stop)
            model = scan[:, None] - gaps[None, :]
            known = model >= 0
            column = np.broadcast_to((scan - start)[:, None], model.shape)
            band[start:stop][known] = block[model[known] - first, column[known]]
        return band


def require_beams(dataset: Dataset, name: str) -> None:
    """Raise ``ConfigError`` unless the data set has beams in the order of sensing."""
    if not dataset.has_beams:
        raise ConfigError(
            f"similarity={name} reads beams in the order of sensing (ranges and angles), which "
            f"this data set ({type(dataset).__name__}) does not have: use similarity=virtual_scan"
        )
