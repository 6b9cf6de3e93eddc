"""The nearest in space of all keyframes: the rule of MOLA."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt
from numpy.typing import NDArray

from rbtm_bench.core.geometry import inverse, rotation_angle, translation_norm
from rbtm_bench.core.kinds import Distance
from rbtm_bench.core.types import Array, Node
from rbtm_bench.selection.base import Selection, Selector
from rbtm_bench.selection.window import Window


class NearestKeyframe(Selector):
    """Every scan is matched to the keyframe nearest to the scan before it, by estimate, however
    old; a scan becomes one when it is ``distance`` m or ``angle_deg`` from every keyframe.

    What is nearest: the larger of the way in units of ``distance`` and the turn in units of
    ``angle_deg`` is the smallest; of equals the older. The last ``keyframes`` are remembered. An
    old keyframe is met again with all the drift since: take a guess of the estimate so far
    (``odometry_chained``, ``constant_velocity``), not one of the odometry since then.

    Source: Blanco-Claraco, "A flexible framework for accurate LiDAR odometry, map manipulation, and
    localization" (MOLA), The International Journal of Robotics Research, 2025.
    """

    def __init__(
        self,
        distance: Distance = 0.3,
        angle_deg: Annotated[float, Gt(0)] = 15.0,
        keyframes: Annotated[int, Ge(1)] = 1000,
    ) -> None:
        super().__init__(capacity=keyframes)
        self.distance, self.angle_deg = distance, angle_deg

    def window(self) -> Window:
        self._newest: Node | None = None
        self._poses: tuple[tuple[int, ...], Array] = ((), np.zeros((0, 4, 4)))
        return Window(self.capacity, self)

    def is_new(self, members: list[Node], node: Node) -> bool:
        """Whether the scan becomes a keyframe; either way it is where the next comes from."""
        self._newest = node
        return bool(self._apart(members, node).min() >= 1.0)

    def choose(self, scan: int, window: Window, scores: Array) -> Selection:
        apart = self._apart(window.nodes, self._newest or window.nodes[-1])
        return self.selection([(int(apart.argmin()), "nearest keyframe")], window.scans, scores)

    def _apart(self, members: list[Node], node: Node) -> Array:
        """How far (W,) a node is from each member, in units of the keyframes' distances."""
        key = (len(members), members[0].scan, members[-1].scan)
        if self._poses[0] != key:  # stacked once a keyframe, not once a scan
            self._poses = (key, np.stack([member.T_world_scan for member in members]))
        T = inverse(node.T_world_scan) @ self._poses[1]
        turned = rotation_angle(T) / np.radians(self.angle_deg)
        return np.maximum(translation_norm(T) / self.distance, turned)

    def order(self, scan: int, models: NDArray[np.int64], scores: Array) -> list[tuple[int, str]]:
        """Not possible by numbers alone: raises ``TypeError``."""
        raise TypeError("NearestKeyframe looks at poses, not numbers: call choose()")
