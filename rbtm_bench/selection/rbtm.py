"""RBTM: real-time backwards threshold matching, the paper's section II.B."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from rbtm_bench.selection.base import Content, Fallback, Selector, keyframes_or_scans
from rbtm_bench.selection.window import Window
from rbtm_bench.types import Array


class Rbtm(Selector):
    """The oldest scan of the window whose similarity to the new scan exceeds ``threshold``.

    ``window`` counts the new scan, as in the paper: w - 1 past scans are candidates. All that
    pass are handed over, oldest first, so that a rejected registration leads to the next.
    ``fallback`` says what follows when none passes or all are rejected: "previous" is the newest
    member of the window, "best" the most similar one, "skip" nothing: the scan is left at its
    predicted pose and, if none passed, is never a model. ``content="keyframes"`` fills the window
    with scans that moved ``keyframe_distance`` m or ``keyframe_angle_deg`` by estimate; every scan
    is still registered.
    """

    needs_scores = True

    def __init__(
        self,
        window: Annotated[int, Ge(2)] = 10,
        threshold: Annotated[float, Ge(-1), Le(1)] = 0.7,
        fallback: Fallback = "previous",
        content: Content = "scans",
        keyframe_distance: Annotated[float, Gt(0)] = 0.3,
        keyframe_angle_deg: Annotated[float, Gt(0)] = 15.0,
    ) -> None:
        super().__init__(capacity=window - 1, fallback=fallback)
        self.threshold = threshold
        self._reason = f"S > {threshold:g}"
        self._keyframes = keyframes_or_scans(content, keyframe_distance, keyframe_angle_deg)

    def window(self) -> Window:
        return Window(self.capacity, self._keyframes)

    def order(self, scan: int, models: NDArray[np.int64], scores: Array) -> list[tuple[int, str]]:
        # NaN > threshold is False: an undefined score never passes
        passing = np.flatnonzero(scores > self.threshold)
        return [(i, self._reason) for i in passing.tolist()]
