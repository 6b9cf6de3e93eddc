"""The last keyframes, and older ones near the model scan."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt

from rbtm_bench.backends.base import Backend, Prepared
from rbtm_bench.core.geometry import inverse, rotation_angle, translation_norm
from rbtm_bench.core.kinds import Distance
from rbtm_bench.core.types import Array, Node
from rbtm_bench.selection.window import Keyframes, Past, Window
from rbtm_bench.target.base import Joined

METRES_PER_RAD = 1.0
"""A turn counts as so much distance: most sensors look one way."""


class NearbyKeyframes(Joined):
    """The last ``keyframes`` scans that moved ``distance`` m or ``angle_deg`` from the one kept
    before, and the ``older`` ones nearest to the model scan, by estimate, no farther than
    ``radius`` m. A place met again is then registered to what was seen there first, as long as the
    drift between is within the method's reach. ``memory`` keyframes are remembered."""

    def __init__(
        self,
        keyframes: Annotated[int, Ge(1)] = 10,
        older: Annotated[int, Ge(0)] = 10,
        radius: Distance = 2.0,
        distance: Distance = 0.5,
        angle_deg: Annotated[float, Gt(0)] = 15.0,
        memory: Annotated[int, Ge(1)] = 2000,
    ) -> None:
        super().__init__()
        self.keyframes, self.older, self.radius, self.memory = keyframes, older, radius, memory
        self._rule = Keyframes(distance, angle_deg)
        self._poses: tuple[list[Node], Array] = ([], np.zeros((0, 4, 4)))

    def window(self, selected: Window) -> Window:
        return Past(selected, self.memory, self._rule)

    def build(self, model: int, window: Window, backend: Backend) -> Prepared:
        chosen = window.node(model)
        past, recent = window.nodes[: -self.keyframes], window.nodes[-self.keyframes :]
        return self.joined(chosen, [*self._near(chosen, past), *recent], backend)

    def _near(self, model: Node, past: list[Node]) -> list[Node]:
        """The older keyframes nearest to the model scan, oldest first."""
        if not past or not self.older:
            return []
        if self._poses[0] != past:  # stacked once a keyframe, not once a scan
            self._poses = (past, np.stack([node.T_world_scan for node in past]))
        T = inverse(model.T_world_scan) @ self._poses[1]
        away = translation_norm(T)
        order = np.argsort(away + METRES_PER_RAD * rotation_angle(T), kind="stable")
        near = [i for i in order.tolist() if away[i] <= self.radius][: self.older]
        return [past[i] for i in sorted(near)]
