"""What a recovery is: other initial guesses, for a registration that the check refused."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

from rbtm_bench.backends.base import Prepared
from rbtm_bench.core.types import Array


class Restart(NamedTuple):
    """Another place to start from, and what it is called in ``steps.parquet``."""

    name: str
    T_target_source: Array


class Recovery(ABC):
    """Where else to start. Whatever ends well from there is held against the same check and the
    same guess; of several that pass the one of the highest fitness is believed."""

    requires: tuple[str, ...] = ()

    @abstractmethod
    def restarts(
        self, source: Prepared, target: Prepared, T_guess: Array, T_rest: Array
    ) -> Sequence[Restart]:
        """Other starts, the first to try first. ``T_guess`` (4, 4) is the guess that failed,
        ``T_rest`` (4, 4) the motion if the sensor had not moved since the previous scan. Must not
        modify its arguments. Raises ``BackendError`` where it cannot look."""
