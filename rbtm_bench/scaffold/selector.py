"""A strategy: which past scan the new one is registered to."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from rbtm_bench.core.types import Array
from rbtm_bench.selection.base import Selector


class NewSelector(Selector):
    """The newest scan of the window that is similar enough, then the next."""

    needs_scores = True  # False: the similarity is not computed, and scores are NaN

    def __init__(
        self,
        window: Annotated[int, Ge(2)] = 10,
        threshold: Annotated[float, Ge(-1), Le(1)] = 0.7,
    ) -> None:
        super().__init__(capacity=window - 1, fallback="previous")
        self.threshold = threshold

    def order(self, scan: int, models: NDArray[np.int64], scores: Array) -> list[tuple[int, str]]:
        """What to try, best first: pairs of a position in the window (0: the oldest) and the
        reason, a few words for steps.parquet. [] leaves it to the fallback.

        ``models`` (W,) are the scans' numbers, oldest first, ``scores`` (W,) their similarity to
        the new scan, NaN where it is undefined.
        """
        similar = np.flatnonzero(scores > self.threshold)
        return [(int(position), "newest similar") for position in similar[::-1]]
