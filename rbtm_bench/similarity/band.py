"""The scores of consecutive scans with those before them, a block of scans at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.types import Array
from rbtm_bench.similarity.base import Descriptor, Similarity, checked_scores


class Band:
    """Scores of scans with the ``width`` scans before each. Memory: a block and ``width`` scans."""

    def __init__(self, similarity: Similarity, width: int) -> None:
        self.similarity, self.width = similarity, width
        self._descriptors: Descriptor | None = None
        self._scores: Array = np.zeros((0, width))
        self._first = 0  # the scan of the first row of scores
        self._next: int | None = None

    def extend(self, scans: NDArray[np.int64], descriptors: Descriptor) -> None:
        """Score a block of scans (N,) by their descriptors (N, D); what is not in the order of
        the scans, one after the other, has no scores."""
        if len(scans) == 0 or (np.diff(scans) != 1).any():
            self._next = self._descriptors = None
            self._scores = np.zeros((0, self.width))
            return
        past = self._descriptors if scans[0] == self._next else None
        together = descriptors if past is None else np.concatenate([past, descriptors])
        skipped = len(together) - len(scans)
        first = {"first": skipped} if skipped else {}  # a stranger's may know whole logs alone
        band = self.similarity.band(together, self.width + 1, **first)
        self._scores = checked_scores(self.similarity, band, (len(scans), self.width))
        self._first = int(scans[0])
        self._next, self._descriptors = int(scans[-1]) + 1, together[-self.width :]

    def scores(self, models: NDArray[np.int64], scan: int) -> Array | None:
        """Scores (W,) of a scan with models (W,), oldest first; None where they are not in the
        band."""
        row, last, count = scan - self._first, int(models[-1]), len(models)
        gap = scan - last
        is_run = last - int(models[0]) + 1 == count
        if (
            not is_run
            or gap < 1
            or gap + count - 1 > self.width
            or not 0 <= row < len(self._scores)
        ):
            return None
        return self._scores[row, gap - 1 : gap + count - 1][::-1]
