"""The most similar scan of the window, however near."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt
from numpy.typing import NDArray

from rbtm_bench.core.kinds import Distance, OpenThreshold
from rbtm_bench.core.types import Array
from rbtm_bench.selection.base import Content, Fallback
from rbtm_bench.selection.thresholded import ThresholdSelector


class Best(ThresholdSelector):
    """The member of the window that is most similar to the new scan, then the next; the older one
    of equals. By default every defined score counts. Settings as in ``ThresholdSelector``."""

    def __init__(
        self,
        window: Annotated[int, Ge(2)] = 10,
        threshold: OpenThreshold = -1.0,
        fallback: Fallback = "previous",
        restart_after: Annotated[int, Ge(1)] | None = None,
        content: Content = "scans",
        keyframe_distance: Distance | None = 0.3,
        keyframe_angle_deg: Annotated[float, Gt(0)] = 15.0,
        keyframe_distance_relative: Annotated[float, Gt(0)] | None = None,
        window_m: Distance | None = None,
    ) -> None:
        super().__init__(
            window,
            threshold,
            fallback,
            restart_after,
            content,
            keyframe_distance,
            keyframe_angle_deg,
            keyframe_distance_relative,
            window_m,
        )

    def order(self, scan: int, models: NDArray[np.int64], scores: Array) -> list[tuple[int, str]]:
        ranked = sorted(self.passing(scores), key=lambda i: (-scores[i], i))
        return [(i, f"rank {rank} by similarity") for rank, i in enumerate(ranked, start=1)]
