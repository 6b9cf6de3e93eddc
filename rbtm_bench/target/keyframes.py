"""The last keyframes."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Gt

from rbtm_bench.backends.base import Backend, Prepared
from rbtm_bench.core.kinds import Distance
from rbtm_bench.selection.window import Keyframes, Past, Window
from rbtm_bench.target.base import Joined


class LastKeyframes(Joined):
    """The last ``keyframes`` scans that moved ``distance`` m or ``angle_deg`` from the one kept
    before, at their estimated poses, whichever scan the selector chose as the model. They are
    joined when a new one comes, and not again before the next."""

    def __init__(
        self,
        keyframes: Annotated[int, Ge(1)] = 10,
        distance: Distance = 0.5,
        angle_deg: Annotated[float, Gt(0)] = 15.0,
    ) -> None:
        super().__init__()
        self.keyframes = keyframes
        self._rule = Keyframes(distance, angle_deg)

    def window(self, selected: Window) -> Window:
        return Past(selected, self.keyframes, self._rule)

    def build(self, model: int, window: Window, backend: Backend) -> Prepared:
        return self.joined(window.node(model), window.nodes[-self.keyframes :], backend)
