"""The standard way: match every scan to the one before it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.types import Array
from rbtm_bench.selection.base import Selector


class Previous(Selector):
    """The model scan is the newest scan of all."""

    def __init__(self) -> None:
        super().__init__(capacity=1)

    def order(self, scan: int, models: NDArray[np.int64], scores: Array) -> list[tuple[int, str]]:
        return [(len(models) - 1, "previous")]
