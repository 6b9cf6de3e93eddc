"""The sliding window of possible model scans: what is remembered, oldest first."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.geometry import inverse, rotation_angle, translation_norm
from rbtm_bench.core.types import Node


class KeyframeRule(Protocol):
    """Which scans a window keeps."""

    def is_new(self, members: list[Node], node: Node) -> bool:
        """Whether a scan is kept beside the members (W >= 1), oldest first. Asked once a scan."""
        ...


@dataclass(frozen=True)
class Keyframes:
    """The window keeps a scan only when it moved this far from the last one kept, by estimate."""

    distance: float
    angle_deg: float

    def is_new(self, members: list[Node], node: Node) -> bool:
        T = inverse(members[-1].T_world_scan) @ node.T_world_scan
        moved = float(translation_norm(T)) >= self.distance
        return moved or float(rotation_angle(T)) >= np.radians(self.angle_deg)


class Window:
    """The last ``capacity`` nodes kept, of these, with ``length``, only those within so many metres
    travelled to the newest node, by estimate: the sum of the straight lines between the estimated
    positions of consecutive nodes. The newest member stays. Memory is bounded by ``capacity``.

    Descriptors and scan numbers lie in buffers of twice the capacity, so that the window is
    always one contiguous slice and moving on costs nothing most of the time.
    """

    def __init__(
        self, capacity: int, keyframes: KeyframeRule | None = None, length: float | None = None
    ) -> None:
        if capacity < 1:
            raise ValueError(f"window capacity {capacity}: expected at least 1")
        self.capacity = capacity
        self.keyframes = keyframes
        self.length = length
        self.is_full = False
        """Whether it has ever had to let a member go, or would with the next."""
        self._travelled = 0.0
        self._odometer: list[float] = []  # at each member (m)
        self._newest: Node | None = None  # of all that were pushed
        self.nodes: list[Node] = []
        self._by_scan: dict[int, Node] = {}
        self._scans = np.zeros(2 * capacity, dtype=np.int64)
        self._descriptors: NDArray[Any] | None = None
        self._start = self._stop = 0

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def scans(self) -> NDArray[np.int64]:
        """Scan numbers (W,) of the members, oldest first."""
        view = self._scans[self._start : self._stop]
        view.flags.writeable = False  # strategies are handed it
        return view

    @property
    def descriptors(self) -> NDArray[Any]:
        """Descriptors (W, D) of the members, oldest first."""
        if self._descriptors is None:
            return np.zeros((len(self), 0))
        return self._descriptors[self._start : self._stop]

    def node(self, scan: int) -> Node:
        """The member that is scan number ``scan``."""
        node = self._by_scan.get(scan)
        if node is None:
            raise KeyError(f"scan {scan} is not in the window")
        return node

    def position(self, scan: int) -> int:
        """Where in the window (0 = oldest) scan number ``scan`` is."""
        position = int(np.searchsorted(self.scans, scan))
        if position == len(self) or self.scans[position] != scan:
            raise KeyError(f"scan {scan} is not in the window")
        return position

    def push(self, node: Node, always: bool = False) -> None:
        """Add a scan, newest last; the oldest goes when the window is full. ``always``: even one
        that is no keyframe."""
        if self._newest is not None and self.length is not None:
            step = node.T_world_scan[:3, 3] - self._newest.T_world_scan[:3, 3]
            self._travelled += math.sqrt(float(step @ step))
        self._newest = node
        rule = None if always or not self.nodes else self.keyframes
        if rule is None or rule.is_new(self.nodes, node):
            self.nodes.append(node)
            self._odometer.append(self._travelled)
            self._by_scan[node.scan] = node
            if len(self.nodes) > self.capacity:
                self._drop_oldest()
            self._write(node)
        while len(self.nodes) > 1 and self._is_left_behind():
            self._drop_oldest()
        self.is_full = self.is_full or len(self.nodes) == self.capacity

    def _is_left_behind(self) -> bool:
        return self.length is not None and self._travelled - self._odometer[0] > self.length

    def _drop_oldest(self) -> None:
        self._odometer.pop(0)
        del self._by_scan[self.nodes.pop(0).scan]
        self._start += 1
        self.is_full = True

    def copied(self) -> Window:
        """A window of the same nodes, with descriptors of its own."""
        other = copy.copy(self)
        if self._descriptors is not None:
            other._descriptors = self._descriptors.copy()
        return other

    def _write(self, node: Node) -> None:
        if self._descriptors is None and node.descriptor is not None:
            shape = (2 * self.capacity, len(node.descriptor))
            self._descriptors = np.zeros(shape, dtype=node.descriptor.dtype)
        if self._stop == 2 * self.capacity:
            live = slice(self._start, self._stop)
            count = self._stop - self._start
            self._scans[:count] = self._scans[live]
            if self._descriptors is not None:
                self._descriptors[:count] = self._descriptors[live]
            self._start, self._stop = 0, count
        self._scans[self._stop] = node.scan
        if self._descriptors is not None:
            self._descriptors[self._stop] = node.descriptor
        self._stop += 1


class Past(Window):
    """What a target remembers of the nodes that enter a selector's window, by a rule of its own;
    by number it knows the members of that window, too."""

    def __init__(self, selected: Window, capacity: int, keyframes: Keyframes | None) -> None:
        super().__init__(capacity, keyframes)
        self._selected = selected

    def node(self, scan: int) -> Node:
        return self._by_scan.get(scan) or self._selected.node(scan)
