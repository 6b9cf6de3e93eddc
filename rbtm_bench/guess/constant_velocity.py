"""The last motion again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array, Node, Scan
from rbtm_bench.guess.base import IDENTITY, Guess, from_previous


class ConstantVelocity(Guess):
    """T_model_scan = inv(T_model) T_previous (inv(T_before) T_previous); no motion before the
    second scan. Scans are taken as evenly spaced in time, as KISS-ICP does."""

    def has_motion(self, recent: Sequence[Node]) -> bool:
        """Two scans at different poses: those that nothing was accepted for stay where they are."""
        if len(recent) < 2:
            return False
        return not np.array_equal(recent[0].T_world_scan, recent[1].T_world_scan)

    def predict(self, model: Node, scan: Scan, recent: Sequence[Node]) -> Array:
        step = IDENTITY
        if len(recent) == 2:
            step = inverse(recent[0].T_world_scan) @ recent[1].T_world_scan
        return from_previous(model, recent, step)
