"""The model scan with a map around it."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from annotated_types import Ge

from rbtm_bench.backends.base import Backend, Prepared
from rbtm_bench.selection.window import Keyframes, Past, Window
from rbtm_bench.target.base import Joined


class AroundModel(Joined):
    """The model scan that the selector chose and up to ``neighbours`` past scans on either side of
    it in time, at their estimated poses.

    Neighbours are scans that moved ``distance`` m or ``angle_deg`` from the neighbour before; with
    0 for both they are what the selector's window keeps. As many of them are remembered as that
    window holds, and ``neighbours`` more, so that its oldest member has them as well.
    """

    def __init__(
        self,
        neighbours: Annotated[int, Ge(1)] = 5,
        distance: Annotated[float, Ge(0)] = 0.5,
        angle_deg: Annotated[float, Ge(0)] = 15.0,
    ) -> None:
        super().__init__()
        self.neighbours = neighbours
        is_spaced = distance > 0 or angle_deg > 0
        self._rule = Keyframes(distance or math.inf, angle_deg or math.inf) if is_spaced else None

    def window(self, selected: Window) -> Window:
        kept, finer = selected.keyframes, 1
        theirs = kept if isinstance(kept, Keyframes) else None  # other rules are asked once a scan
        rule = self._rule or theirs
        if rule is not None and theirs is not None:  # several neighbours between two of theirs
            ratio = max(theirs.distance / rule.distance, theirs.angle_deg / rule.angle_deg)
            finer = max(1, math.ceil(ratio))
        return Past(selected, selected.capacity * finer + self.neighbours, rule)

    def build(self, model: int, window: Window, backend: Backend) -> Prepared:
        at = int(np.searchsorted(window.scans, model))
        nodes, chosen = window.nodes, window.node(model)
        after = at + (at < len(nodes) and nodes[at] is chosen)
        members = [
            *nodes[max(0, at - self.neighbours) : at],
            chosen,
            *nodes[after : after + self.neighbours],
        ]
        return self.joined(chosen, members, backend)
