"""A similarity: a descriptor a scan, and the scores of a whole window in one call."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Gt

from rbtm_bench.core.types import Array, Scan
from rbtm_bench.similarity.base import Descriptor, Similarity


class NewSimilarity(Similarity):
    """How alike the mean ranges of two scans are."""

    def __init__(self, scale: Annotated[float, Gt(0)] = 1.0) -> None:
        self.scale = scale  # m

    def describe(self, scan: Scan) -> Descriptor:
        """The descriptor (D,), of one length and type for all scans; NaN where it is undefined."""
        ranges = np.linalg.norm(scan.points, axis=1)
        return np.array([ranges.mean() if len(ranges) else np.nan])

    def scores(self, window: Descriptor, descriptor: Descriptor) -> Array:
        """Scores (W,) in [-1, 1] of the window's descriptors (W, D) against one (D,)."""
        return np.exp(-np.abs(window[:, 0] - descriptor[0]) / self.scale)
