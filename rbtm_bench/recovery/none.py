"""No second try: the next candidate, and then the guess."""

from __future__ import annotations

from collections.abc import Sequence

from rbtm_bench.backends.base import Prepared
from rbtm_bench.core.types import Array
from rbtm_bench.recovery.base import Recovery, Restart


class NoRecovery(Recovery):
    """Nothing else is tried."""

    def restarts(
        self, source: Prepared, target: Prepared, T_guess: Array, T_rest: Array
    ) -> Sequence[Restart]:
        return ()
