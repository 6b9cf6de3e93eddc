"""Keyframes that come where the last one is left behind: the rule of GLIM."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.kinds import Threshold
from rbtm_bench.core.types import Array, Node
from rbtm_bench.selection.base import Selection, Selector
from rbtm_bench.selection.window import Window


class OverlapKeyframe(Selector):
    """Every scan is matched to the last keyframe; a scan becomes one when its similarity to the
    last is less than ``below``, or undefined. With ``similarity=overlap`` that is the share of
    points seen by both, under the guess: the scan is not registered yet when it is asked.

    Source: Koide, Yokozuka, Oishi and Banno, "GLIM: 3D range-inertial localization and mapping
    with GPU-accelerated scan matching factors", Robotics and Autonomous Systems 179, 2024.
    """

    needs_scores = True

    def __init__(self, below: Threshold = 0.7) -> None:
        super().__init__(capacity=1)
        self.below = below

    def window(self) -> Window:
        self._last = (-1, np.nan)
        return Window(1, self)

    def choose(self, scan: int, window: Window, scores: Array) -> Selection:
        self._last = (scan, float(scores[-1]))
        return super().choose(scan, window, scores)

    def is_new(self, members: list[Node], node: Node) -> bool:
        """Whether the scan becomes a keyframe, by the score that it was chosen for with."""
        scan, score = self._last
        return scan != node.scan or not score >= self.below

    def order(self, scan: int, models: NDArray[np.int64], scores: Array) -> list[tuple[int, str]]:
        return [(0, "keyframe")]
