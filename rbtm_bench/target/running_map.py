"""A running map of the past scans."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Annotated
from weakref import WeakKeyDictionary

import numpy as np
from annotated_types import Ge, Gt

from rbtm_bench.backends.base import Backend, MapLimits, Placed, Prepared, RunningMap, TargetKey
from rbtm_bench.core.kinds import Distance
from rbtm_bench.core.types import Node
from rbtm_bench.selection.window import Keyframes, Past, Window
from rbtm_bench.target.base import Target
from rbtm_bench.target.voxels import VoxelMap

UNSEEN = 16
"""Scans that may come between two registrations and are still added to the map."""

RANGE = 100.0
"""m, that a map reaches if nobody says."""


@dataclass
class _Running:
    """A map at work: the scans it was made of, as (node, key), and the number of the newest."""

    map: RunningMap
    members: deque[tuple[Node, TargetKey]] = field(default_factory=deque)
    newest: int = -1


class RunningVoxelMap(Target):
    """All past scans at their estimated poses in one map of voxels, of which what lies beyond
    ``max_range`` m (null: 100) or was met by none of the last ``horizon`` scans is forgotten.

    The map is the library's own where a backend has one: small_gicp's Gaussian voxels for VGICP
    (which forget by ``horizon`` alone), KISS-ICP's hash map (by ``max_range`` alone). Other
    backends are given the points of ours, means in cells of ``cell_size`` m, and prepare them
    after every scan that was added: set ``distance`` (m) or ``angle_deg``, so that only scans that
    moved so far are (0 for both: every scan).
    """

    def __init__(
        self,
        cell_size: Distance | None = None,
        max_range: Annotated[float, Gt(0)] | None = None,
        horizon: Annotated[int, Ge(1)] = 100,
        distance: Annotated[float, Ge(0)] = 0.0,
        angle_deg: Annotated[float, Ge(0)] = 0.0,
    ) -> None:
        self._cell_size = cell_size
        self._limits = MapLimits(max_range or RANGE, horizon)
        is_spaced = distance > 0 or angle_deg > 0
        self._rule = Keyframes(distance or np.inf, angle_deg or np.inf) if is_spaced else None
        self._maps: WeakKeyDictionary[Window, _Running] = WeakKeyDictionary()

    def window(self, selected: Window) -> Window:
        return Past(selected, UNSEEN, self._rule)

    def build(self, model: int, window: Window, backend: Backend) -> Prepared:
        running = self._maps.get(window)
        if running is None:
            own = backend.running_map(self._limits)
            running = _Running(own or VoxelMap(backend, self._limits, self._cell_size))
            self._maps[window] = running
        for node in window.nodes[int(np.searchsorted(window.scans, running.newest, "right")) :]:
            self._insert(node, running)
        key = tuple(part for _, parts in running.members for part in parts)
        return Placed(running.map.target(), window.node(model).T_world_scan, key)

    def _insert(self, node: Node, running: _Running) -> None:
        """Add a scan; forget those of which nothing can be left."""
        running.map.insert(node.prepared, node.T_world_scan)
        running.newest = node.scan
        placed = node.T_world_scan.tobytes()
        running.members.append((node, tuple((number, placed) for number, _ in node.prepared.key)))
        horizon, reach = self._limits.horizon, 2.0 * self._limits.max_range
        while len(running.members) > horizon or _is_beyond(running.members[0][0], node, reach):
            running.members.popleft()


def _is_beyond(old: Node, new: Node, reach: float) -> bool:
    """Whether two scans stand more than ``reach`` m apart."""
    off = old.T_world_scan[:3, 3] - new.T_world_scan[:3, 3]
    return float(np.linalg.norm(off)) > reach
