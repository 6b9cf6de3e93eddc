"""Control: always the scan a fixed number of scans ago."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray

from rbtm_bench.core.types import Array
from rbtm_bench.selection.base import Selector


class FixedGap(Selector):
    """The model scan is scan - ``gap`` (the oldest scan, at the start of a run).

    A gap between whole numbers is dithered: scan i takes floor(i gap) - floor((i - 1) gap), the
    whole numbers beside it in the order of a drawn line, whose mean over n scans is ``gap`` to
    within 1 / n.
    """

    def __init__(self, gap: Annotated[float, Ge(1)] = 10) -> None:
        super().__init__(capacity=math.ceil(gap))
        self.gap = gap

    def order(self, scan: int, models: NDArray[np.int64], scores: Array) -> list[tuple[int, str]]:
        gap = math.floor(scan * self.gap) - math.floor((scan - 1) * self.gap)
        return [(nearest_gap(scan, models, gap), f"gap {gap}")]


def nearest_gap(scan: int, models: NDArray[np.int64], gap: int) -> int:
    """Position of the member nearest to ``scan - gap`` (members can be missing: skipped scans)."""
    return int(np.argmin(np.abs(models - (scan - gap))))
