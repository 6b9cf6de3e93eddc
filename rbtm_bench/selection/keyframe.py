"""Control: the last keyframe."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import numpy as np
from annotated_types import Gt
from numpy.typing import NDArray

from rbtm_bench.core.kinds import Distance
from rbtm_bench.core.types import Array
from rbtm_bench.selection.base import Selector, keyframes_every
from rbtm_bench.selection.window import Window


class Keyframe(Selector):
    """Every scan is matched to the last keyframe; a scan becomes a keyframe when it moved
    ``distance`` m or ``angle_deg`` from the last one, by estimate. Where ``distance`` is None a run
    makes it ``distance_relative`` times the median range of the data's first part."""

    idle_settings: ClassVar[dict[str, Any]] = {"distance_relative": ("distance", ...)}

    def __init__(
        self,
        distance: Distance | None = 0.3,
        angle_deg: Annotated[float, Gt(0)] = 15.0,
        distance_relative: Annotated[float, Gt(0)] | None = None,
    ) -> None:
        super().__init__(capacity=1)
        self._keyframes = keyframes_every(distance, angle_deg)

    def window(self) -> Window:
        return Window(1, self._keyframes)

    def order(self, scan: int, models: NDArray[np.int64], scores: Array) -> list[tuple[int, str]]:
        return [(0, "keyframe")]
