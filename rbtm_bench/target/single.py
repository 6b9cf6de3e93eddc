"""The model scan alone."""

from __future__ import annotations

from rbtm_bench.backends.base import Backend, Prepared
from rbtm_bench.selection.window import Window
from rbtm_bench.target.base import Target


class SingleScan(Target):
    """The model scan alone, as in the paper."""

    def build(self, model: int, window: Window, backend: Backend) -> Prepared:
        return window.node(model).prepared
