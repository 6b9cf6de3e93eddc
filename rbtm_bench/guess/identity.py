"""No motion since the model scan."""

from __future__ import annotations

from collections.abc import Sequence

from rbtm_bench.core.types import Array, Node, Scan
from rbtm_bench.guess.base import IDENTITY, Guess


class Identity(Guess):
    """T_model_scan = I."""

    pure = True

    def predict(self, model: Node, scan: Scan, recent: Sequence[Node]) -> Array:
        return IDENTITY.copy()
