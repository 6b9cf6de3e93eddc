"""What a scan is registered to: the model scan alone, or a small map around it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Annotated

from annotated_types import Ge

from rbtm_bench.backends.base import Backend, Prepared
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Node
from rbtm_bench.selection.window import Window


class Target(ABC):
    """Builds the target of a registration, in the frame of the model scan."""

    requires: tuple[str, ...] = ()

    @abstractmethod
    def build(self, model: int, window: Window, backend: Backend) -> Prepared:
        """The prepared target for model scan number ``model``, a member of the window."""


class SingleScan(Target):
    """The model scan alone, as in the paper."""

    def build(self, model: int, window: Window, backend: Backend) -> Prepared:
        return window.node(model).prepared


class LocalMap(Target):
    """The model scan and up to ``neighbours`` members of the window on either side of it, placed
    by their estimated poses and merged into one cloud. The last map built is kept."""

    def __init__(self, neighbours: Annotated[int, Ge(1)] = 2) -> None:
        self.neighbours = neighbours
        self._last: tuple[list[Node], Prepared] | None = None

    def build(self, model: int, window: Window, backend: Backend) -> Prepared:
        at = window.position(model)
        members = window.nodes[max(0, at - self.neighbours) : at + self.neighbours + 1]
        # nodes compare by identity: scan numbers alone would mix up two runs of one object
        key = [window.nodes[at], *members]
        if self._last is None or self._last[0] != key:
            T_model_world = inverse(window.nodes[at].T_world_scan)
            parts = [(node.prepared, T_model_world @ node.T_world_scan) for node in members]
            self._last = (key, backend.merge(parts))
        return self._last[1]
