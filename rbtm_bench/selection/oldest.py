"""Control: the oldest scan of the window, whatever its similarity."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt
from numpy.typing import NDArray

from rbtm_bench.core.kinds import Distance
from rbtm_bench.core.types import Array
from rbtm_bench.selection.base import Content, Selector, keyframes_or_scans
from rbtm_bench.selection.window import Window


class Oldest(Selector):
    """RBTM without its threshold: what the window alone achieves. Parameters as in ``Rbtm``."""

    def __init__(
        self,
        window: Annotated[int, Ge(2)] = 10,
        content: Content = "scans",
        keyframe_distance: Distance | None = 0.3,
        keyframe_angle_deg: Annotated[float, Gt(0)] = 15.0,
        keyframe_distance_relative: Annotated[float, Gt(0)] | None = None,
        window_m: Distance | None = None,
    ) -> None:
        super().__init__(capacity=window - 1)
        self._keyframes = keyframes_or_scans(content, keyframe_distance, keyframe_angle_deg)
        self._window_m = window_m

    def window(self) -> Window:
        return Window(self.capacity, self._keyframes, self._window_m)

    def order(self, scan: int, models: NDArray[np.int64], scores: Array) -> list[tuple[int, str]]:
        return [(0, "oldest")]
