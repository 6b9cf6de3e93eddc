"""A small map around the model scan."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge

from rbtm_bench.backends.base import Backend, Prepared
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.kinds import VoxelSize
from rbtm_bench.core.types import Node
from rbtm_bench.selection.window import Window
from rbtm_bench.target.base import Target


class LocalMap(Target):
    """The model scan and up to ``neighbours`` members of the window on either side of it, placed
    by their estimated poses and merged into one cloud, thinned to ``voxel_size`` m (None: the
    backend's ``voxel_size``; its scans are thinned by that beforehand). The last map built is kept.
    """

    needs_nodes = 2  # of fewer it is the model scan alone

    def __init__(
        self, neighbours: Annotated[int, Ge(1)] = 2, voxel_size: VoxelSize | None = None
    ) -> None:
        self.neighbours = neighbours
        self.voxel_size = voxel_size
        self._last: tuple[list[Node], Prepared] | None = None

    def build(self, model: int, window: Window, backend: Backend) -> Prepared:
        at = window.position(model)
        members = window.nodes[max(0, at - self.neighbours) : at + self.neighbours + 1]
        # nodes compare by identity: scan numbers alone would mix up two runs of one object
        key = [window.nodes[at], *members]
        if self._last is None or self._last[0] != key:
            T_model_world = inverse(window.nodes[at].T_world_scan)
            parts = [(node.prepared, T_model_world @ node.T_world_scan) for node in members]
            thin = {} if self.voxel_size is None else {"voxel_size": self.voxel_size}
            self._last = (key, backend.merge(parts, **thin))
        return self._last[1]
