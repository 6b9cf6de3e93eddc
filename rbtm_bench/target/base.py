"""What a scan is registered to."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from rbtm_bench.backends.base import Backend, Placed, Prepared
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Node
from rbtm_bench.selection.window import Window


class Target(ABC):
    """Builds the target of a registration, in the frame of the model scan."""

    requires: tuple[str, ...] = ()
    needs_nodes: int = 1
    """Past scans that a selector's window must be able to hold, the model scan included, for the
    target to be what it says: refused with one that holds fewer."""

    @abstractmethod
    def build(self, model: int, window: Window, backend: Backend) -> Prepared:
        """The prepared target for model scan number ``model``, which ``window.node`` knows."""

    def window(self, selected: Window) -> Window:
        """The window of past nodes that it needs beside the selector's, new and empty, to be
        handed to ``build``; by default the selector's own, ``selected``."""
        return selected


class Joined(Target):
    """A target of several scans, joined by the backend in the frame of the newest and kept as long
    as they stay the same, whatever the model scan."""

    def __init__(self) -> None:
        self._last: tuple[list[Node], Prepared] | None = None

    def joined(self, model: Node, members: Sequence[Node], backend: Backend) -> Prepared:
        """The members (oldest first), seen from the model scan."""
        if len(members) == 1 and members[0] is model:
            return model.prepared
        newest, nodes = members[-1], list(members)
        # nodes compare by identity: scan numbers alone would mix up two runs of one object
        if self._last is None or self._last[0] != nodes:
            T_newest_world = inverse(newest.T_world_scan)
            parts = [(node.prepared, T_newest_world @ node.T_world_scan) for node in nodes]
            self._last = (nodes, backend.join(parts))
        built = self._last[1]
        if model is newest:
            return built
        return Placed(built, inverse(newest.T_world_scan) @ model.T_world_scan)
