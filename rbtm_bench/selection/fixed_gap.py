"""Control: always the scan a fixed number of scans ago."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray

from rbtm_bench.core.types import Array
from rbtm_bench.selection.base import Selector


class FixedGap(Selector):
    """The model scan is scan - ``gap`` (the oldest scan, at the start of a run)."""

    def __init__(self, gap: Annotated[int, Ge(1)] = 10) -> None:
        super().__init__(capacity=gap)
        self.gap = gap

    def order(self, scan: int, models: NDArray[np.int64], scores: Array) -> list[tuple[int, str]]:
        return [(nearest_gap(scan, models, self.gap), f"gap {self.gap}")]


def nearest_gap(scan: int, models: NDArray[np.int64], gap: int) -> int:
    """Position of the member nearest to ``scan - gap`` (members can be missing: skipped scans)."""
    return int(np.argmin(np.abs(models - (scan - gap))))
