"""No motion since the model scan."""

from __future__ import annotations

from collections.abc import Sequence

from rbtm_bench.guess.base import IDENTITY, Guess
from rbtm_bench.types import Array, Node, Scan


class Identity(Guess):
    """T_model_scan = I."""

    pure = True

    def predict(self, model: Node, scan: Scan, recent: Sequence[Node]) -> Array:
        return IDENTITY.copy()
