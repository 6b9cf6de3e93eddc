"""No registration: the guess as it is. The baseline row of every comparison."""

from __future__ import annotations

from rbtm_bench.backends.base import Alignment, Backend, Prepared
from rbtm_bench.core.types import Array


class NoRegistration(Backend):
    """Hands back the initial guess: dead reckoning by the ``guess`` in use."""

    is_baseline = True
    library = "none"
    converged_means = "never reported"

    def build(self, points: Array, planar: bool) -> None:
        return None

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        return Alignment(T_target_source, iterations=0)
