"""Candidates by position: where the path comes near itself, as far as it can tell."""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt
from scipy.spatial import cKDTree

from rbtm_bench.core.geometry import inverse, rotation_angle
from rbtm_bench.core.kinds import Distance
from rbtm_bench.core.types import Array
from rbtm_bench.loops.closing import GraphLoops
from rbtm_bench.loops.track import Places, Track
from rbtm_bench.loops.verify import Limits, Pair

METRES_PER_RAD = 1.0
"""A turn between two keyframes counts as so much distance: most sensors look one way."""

CHOICES = 5
"""Candidates a keyframe: the motion to the nearest may be the least sure."""


class PositionLoops(GraphLoops):
    """For every keyframe the nearest of the older ones that are no farther than the drift allows:
    ``radius_m`` and ``drift`` times the path between the two, at most ``most_m``. Once there are
    loops, what has drifted is the path from either to the next keyframe on a loop, if that is
    less. Other parameters as in ``GraphLoops``."""

    def __init__(
        self,
        radius_m: Distance = 2.0,
        drift: Annotated[float, Ge(0)] = 0.03,
        most_m: Annotated[float, Gt(0)] = 8.0,
        keyframe_distance: Distance = 0.5,
        keyframe_angle_deg: Annotated[float, Gt(0)] = 15.0,
        apart_m: Annotated[float, Gt(0)] = 10.0,
        phi: Annotated[float, Gt(0)] = 5.0,
        rounds: Annotated[int, Ge(1)] = 10,
        verify: Limits | None = None,
    ) -> None:
        super().__init__(keyframe_distance, keyframe_angle_deg, apart_m, phi, rounds, verify)
        self.radius_m, self.drift, self.most_m = radius_m, drift, most_m

    def pairs(
        self, track: Track, T_world_scan: Array, tried: Collection[Pair], closed: Places
    ) -> list[Pair]:
        positions, loose = T_world_scan[:, :3, 3], np.full(len(track.path), np.inf)
        if len(closed):
            loose = np.abs(track.path[:, None] - track.path[closed]).min(axis=1)
        pairs = []
        for scan, near in enumerate(cKDTree(positions).query_ball_point(positions, self.most_m)):
            models = np.array(near, dtype=np.int64)
            path = track.path[scan] - track.path[models]
            distance = np.linalg.norm(positions[models] - positions[scan], axis=1)
            drifted = self.drift * np.minimum(path, loose[scan] + loose[models])
            allowed = np.minimum(self.most_m, self.radius_m + drifted)
            inside = (path > self.apart_m) & (distance <= allowed)
            models, distance = models[inside], distance[inside]
            turn = rotation_angle(inverse(T_world_scan[models]) @ T_world_scan[scan])
            order = np.lexsort((models, distance + METRES_PER_RAD * turn))
            untried = (Pair(int(models[i]), scan) for i in order)
            pairs += [pair for pair in untried if pair not in tried][:CHOICES]
        return pairs
