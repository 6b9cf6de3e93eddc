"""Every scan of the window is a model scan, and all of them have a say in the pose."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt
from numpy.typing import NDArray

from rbtm_bench.core.kinds import Distance
from rbtm_bench.core.types import Array
from rbtm_bench.selection.base import Content, Selector, keyframes_or_scans
from rbtm_bench.selection.window import Window


class WindowGraph(Selector):
    """RBTM_k without its threshold and with all edges: what a window can give for a registration a
    member. Members stay where they are once placed. Parameters as in ``Rbtm``.

    Source: "Lidar-only Odometry based on Multiple Scan-to-Scan Alignments over a Moving Window",
    arXiv 2503.21293, whose graph corrects the window's older poses as well.
    """

    covariance_from = "localizability"

    def __init__(
        self,
        window: Annotated[int, Ge(2)] = 5,
        content: Content = "scans",
        keyframe_distance: Distance = 0.3,
        keyframe_angle_deg: Annotated[float, Gt(0)] = 15.0,
    ) -> None:
        super().__init__(capacity=window - 1)
        self._keyframes = keyframes_or_scans(content, keyframe_distance, keyframe_angle_deg)
        self.edges = window - 1

    def window(self) -> Window:
        return Window(self.capacity, self._keyframes)

    def order(self, scan: int, models: NDArray[np.int64], scores: Array) -> list[tuple[int, str]]:
        return [(i, "in the window") for i in range(len(models))]
