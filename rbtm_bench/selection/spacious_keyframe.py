"""Keyframes whose distance grows with the place: the rule of DLIO."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Gt
from numpy.typing import NDArray

from rbtm_bench.core.kinds import Distance
from rbtm_bench.core.types import Array, Node, Scan
from rbtm_bench.selection.base import Selector
from rbtm_bench.selection.window import Keyframes, Window

KEPT = 0.95
"""Of the spaciousness so far, with each new scan; the rest is that scan's median range."""


class SpaciousKeyframe(Selector):
    """Every scan is matched to the last keyframe; a scan becomes one when it moved ``share`` times
    the spaciousness (a low-pass filtered median range, m) or ``angle_deg`` from the last, by
    estimate; the distance is at least ``nearest`` m and at most ``farthest`` m.

    Source: Chen, Nemiroff and Lopez, "Direct LiDAR-Inertial Odometry", ICRA 2023, whose values are
    share 1, 0.5 m, 5 m and 45 deg; there the points are those of a spinning lidar.
    """

    needs_scans = True

    def __init__(
        self,
        share: Annotated[float, Gt(0)] = 0.1,
        nearest: Distance = 0.1,
        farthest: Distance = 5.0,
        angle_deg: Annotated[float, Gt(0)] = 15.0,
    ) -> None:
        super().__init__(capacity=1)
        self.share, self.nearest, self.farthest = share, nearest, farthest
        self.angle_deg = angle_deg

    def window(self) -> Window:
        self._distances: dict[int, float] = {}
        self._spaciousness = np.nan
        return Window(1, self)

    def see(self, scan: Scan) -> None:
        if len(scan.points):
            now = float(np.median(np.linalg.norm(scan.points, axis=1)))
            before = now if np.isnan(self._spaciousness) else self._spaciousness
            self._spaciousness = KEPT * before + (1.0 - KEPT) * now
        distance = np.clip(self.share * self._spaciousness, self.nearest, self.farthest)
        self._distances[scan.index] = float(distance)

    def is_new(self, members: list[Node], node: Node) -> bool:
        """Whether the scan becomes a keyframe; distances of the scans before it are forgotten."""
        distance = self._distances[node.scan]
        self._distances = {i: d for i, d in self._distances.items() if i >= node.scan}
        return Keyframes(distance, self.angle_deg).is_new(members, node)

    def order(self, scan: int, models: NDArray[np.int64], scores: Array) -> list[tuple[int, str]]:
        return [(0, "keyframe")]
