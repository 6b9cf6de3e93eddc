"""Scans that hardly moved hang on the one before, by the guess alone: no drift while standing."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rbtm_bench.core.rigid import apart
from rbtm_bench.core.types import Node
from rbtm_bench.odometry.method import Ready, Work


def is_still(ready: Ready, recent: Sequence[Node], moving: Node | None, work: Work) -> bool:
    """Whether a scan has moved less than ``Method.motion_filter`` since ``moving``, the last that
    was not still: by the estimate so far and the guess of the last step."""
    most = work.method.motion_filter
    if moving is None or most.distance <= 0.0 or most.angle_deg <= 0.0:
        return False
    last = recent[-1]
    T_world_scan = last.T_world_scan @ work.predict(last, ready.scan, recent)
    distance, turn = apart(moving.T_world_scan, T_world_scan)
    return distance < most.distance and math.degrees(turn) < most.angle_deg
