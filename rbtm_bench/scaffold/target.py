"""What a scan is registered to, once the model scan is chosen."""

from __future__ import annotations

from rbtm_bench.backends.base import Backend, Prepared
from rbtm_bench.core.geometry import inverse
from rbtm_bench.selection.window import Window
from rbtm_bench.target.base import Target


class NewTarget(Target):
    """The model scan and the one before it, joined by their estimated poses."""

    def build(self, model: int, window: Window, backend: Backend) -> Prepared:
        """The prepared target in the frame of the model scan."""
        at = window.position(model)
        T_model_world = inverse(window.nodes[at].T_world_scan)
        members = window.nodes[max(0, at - 1) : at + 1]
        return backend.join([(n.prepared, T_model_world @ n.T_world_scan) for n in members])
