"""What a similarity is: a descriptor a scan, and the scores of a whole window in one call."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import Dataset

Descriptor = NDArray[Any]

BLOCK = 256


class Similarity(ABC):
    """Scores in [-1, 1] of how alike two scans are; NaN where a score is undefined.

    A plug-in writes ``describe`` and ``scores``. Descriptors are 1-D arrays of one length and
    type for a whole data set, so that a window of them is a matrix.

    One that compares scans under the initial guess sets ``needs_guess`` and writes
    ``scores_under`` as well; its ``scores``, and the ``matrix`` and ``band`` made of them, are
    those of no motion.
    """

    requires: tuple[str, ...] = ()
    """Names of the Python packages that must be importable."""
    needs_guess: bool = False
    """Whether ``scores_under`` reads the motions."""

    def check(self, dataset: Dataset) -> None:  # noqa: B027 (optional to override)
        """Raise ``ConfigError`` if this similarity cannot read the data set."""

    @abstractmethod
    def describe(self, scan: Scan) -> Descriptor:
        """The descriptor (D,) of a scan."""

    def describe_all(self, scans: Sequence[Scan]) -> Descriptor:
        """The descriptors (N, D) of scans, the same bits as one by one."""
        return np.stack([self.describe(scan) for scan in scans])

    def curve(self, descriptor: Descriptor) -> tuple[str, Array] | None:
        """What of a descriptor (D,) a reader can look at, over the beams: its name with the unit,
        and values (B,), NaN where undefined. None: it is no curve."""
        if np.iscomplexobj(descriptor):
            return "phase (deg)", np.degrees(np.angle(descriptor))
        return "descriptor", np.asarray(descriptor, dtype=np.float64)

    @abstractmethod
    def scores(self, window: Descriptor, descriptor: Descriptor) -> Array:
        """Scores (W,) of the window's descriptors (W, D) against one descriptor (D,)."""

    def scores_under(self, window: Descriptor, descriptor: Descriptor, motions: Array) -> Array:
        """Scores (W,) as ``scores``, given the guessed T_model_scan (W, 4, 4) of the new scan
        from each of the window's members; without ``needs_guess`` they change nothing."""
        return self.scores(window, descriptor)

    def pairwise(self, rows: Descriptor, columns: Descriptor) -> Array:
        """Scores (M, K) of descriptors (M, D) against descriptors (K, D)."""
        return np.stack([self.scores(rows, d) for d in columns], axis=1)

    def matrix(self, descriptors: Descriptor) -> Array:
        """Scores (N, N) of all pairs of N descriptors (N, D): Fig. 1(c) of the paper."""
        return self.pairwise(descriptors, descriptors)

    def band(self, descriptors: Descriptor, window: int, first: int = 0) -> Array:
        """Scores (N - first, window - 1) of consecutive scans, from number ``first`` on: column
        g - 1 of row j - first holds S(j, j - g), NaN if g > j.

        The same bits as ``scores`` gives a scan at a time. Memory: the band, one window's work.
        """
        band = np.full((len(descriptors) - first, window - 1), np.nan)
        for j in range(max(1, first), len(descriptors)):
            past = descriptors[max(0, j - window + 1) : j]
            scores = checked_scores(self, self.scores(past, descriptors[j]), (len(past),))
            band[j - first, : len(past)] = scores[::-1]
        return band


class PairwiseSimilarity(Similarity):
    """A similarity whose score is made of inner products, so that any set of pairs is one call.

    A plug-in writes ``pair_scores`` instead of ``scores``. A pair's bits do not depend on which
    others it is computed with (``inner`` takes every pair by itself; a matrix product would not,
    nor ``np.vecdot`` on every processor), so a band computed beforehand and scores computed scan by
    scan are the same.
    """

    @abstractmethod
    def pair_scores(self, rows: Descriptor, columns: Descriptor) -> Array:
        """Scores (...) of descriptors (..., D) and (..., D), whose leading axes broadcast."""

    def scores(self, window: Descriptor, descriptor: Descriptor) -> Array:
        return self.pair_scores(window, descriptor[None])

    def pairwise(self, rows: Descriptor, columns: Descriptor) -> Array:
        return self.pair_scores(rows[:, None], columns[None])

    def band(self, descriptors: Descriptor, window: int, first: int = 0) -> Array:
        count = len(descriptors)
        band = np.full((count - first, window - 1), np.nan)
        for start in range(first, count, BLOCK):  # a block of descriptors stays in the cache
            stop = min(start + BLOCK, count)
            for gap in range(1, min(window, stop)):
                j = max(start, gap)
                past, now = descriptors[j - gap : stop - gap], descriptors[j:stop]
                scores = checked_scores(self, self.pair_scores(past, now), (len(past),))
                band[j - first : stop - first, gap - 1] = scores
        return band


def checked_scores(similarity: Similarity, scores: Any, shape: tuple[int, ...]) -> Array:
    """Scores as a similarity may give them: real numbers, finite or NaN. Raises ``ValueError``."""
    name = type(similarity).__name__
    kind = np.asarray(scores).dtype
    if np.shape(scores) != shape or kind.kind not in "fiu":
        what = f"shape {np.shape(scores)}" if np.shape(scores) != shape else kind.name
        raise ValueError(f"{name}: scores of {what}: expected real ones, {shape}")
    checked = np.asarray(scores, dtype=np.float64)
    if np.isinf(checked).any():
        raise ValueError(f"{name}: a score is infinite: expected finite numbers, or NaN")
    return checked


def require_beams(dataset: Dataset, name: str) -> None:
    """Raise ``ConfigError`` unless the data set has beams in the order of sensing."""
    if not dataset.has_beams:
        raise ConfigError(
            f"similarity={name} reads beams in the order of sensing (ranges and angles), which "
            f"this data set ({type(dataset).__name__}) does not have: use similarity=virtual_scan"
        )


def beam_spacing(angles: Array, before: float | None, name: str) -> float:
    """The angle between beams (B,), rad, negative for a sensor that turns clockwise.

    Raises ``DataError`` for one beam, and if it is not what it was ``before`` (None: unknown).
    """
    if len(angles) < 2:
        raise DataError(f"{name}: a scan of one beam: expected at least two")
    spacing = float(angles[-1] - angles[0]) / (len(angles) - 1)
    if before is not None and abs(spacing - before) > 1e-9:
        raise DataError(f"{name}: the beam spacing changes within the data set")
    return spacing
