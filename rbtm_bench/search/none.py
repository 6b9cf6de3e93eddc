"""No search: the guess is where a registration starts."""

from __future__ import annotations

import math

from rbtm_bench.backends.base import Backend, Prepared
from rbtm_bench.core.types import Array
from rbtm_bench.search.base import Search, Start


class NoSearch(Search):
    """The guess as it is; the backend is left alone."""

    searches = False

    def start(self, source: Prepared, target: Prepared, T_target_source: Array) -> Start:
        return Start(T_target_source, math.nan, math.nan)

    def before(self, backend: Backend) -> Backend:
        return backend
