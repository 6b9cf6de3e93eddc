"""What a scan is registered to."""

from __future__ import annotations

from abc import ABC, abstractmethod

from rbtm_bench.backends.base import Backend, Prepared
from rbtm_bench.selection.window import Window


class Target(ABC):
    """Builds the target of a registration, in the frame of the model scan."""

    requires: tuple[str, ...] = ()
    needs_nodes: int = 1
    """Past scans that a selector's window must be able to hold, the model scan included, for the
    target to be what it says: refused with one that holds fewer."""

    @abstractmethod
    def build(self, model: int, window: Window, backend: Backend) -> Prepared:
        """The prepared target for model scan number ``model``, a member of the window."""
