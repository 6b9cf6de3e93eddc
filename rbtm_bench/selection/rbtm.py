"""RBTM: real-time backwards threshold matching, the paper's section II.B."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.types import Array
from rbtm_bench.selection.thresholded import ThresholdSelector


class Rbtm(ThresholdSelector):
    """The oldest scan of the window whose similarity to the new scan exceeds ``threshold``.

    All that pass are handed over, oldest first, so that a rejected registration leads to the next.
    Settings as in ``ThresholdSelector``.
    """

    def order(self, scan: int, models: NDArray[np.int64], scores: Array) -> list[tuple[int, str]]:
        return [(i, self.passed) for i in self.passing(scores)]
