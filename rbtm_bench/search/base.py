"""What a search is, and a backend that starts where a search ends.

The loop knows of none: a search and the backend behind it are one backend to whoever registers.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple

from rbtm_bench.backends.base import Alignment, Backend, MapLimits, Prepared, RunningMap
from rbtm_bench.core.types import Array, Scan


class Start(NamedTuple):
    """Where a registration starts: the motion (4, 4), how well it scores there (0 to 1), and the
    score of the best other place as a share of that, NaN if not looked for."""

    T_target_source: Array
    score: float
    peak_ratio: float


class Search(ABC):
    """Looks around the guess for a better start than the guess itself."""

    requires: tuple[str, ...] = ()
    dimensions: tuple[Literal["2d", "3d"], ...] = ("2d", "3d")
    """What it can search: planar scans ("2d"), clouds in space ("3d")."""
    searches: bool = True
    """False for one that does nothing: then nothing of it makes runs or pairs differ."""

    @abstractmethod
    def start(self, source: Prepared, target: Prepared, T_target_source: Array) -> Start:
        """Where to start, from a guess (4, 4). Must not modify its arguments. Raises
        ``BackendError`` where it cannot look."""

    def before(self, backend: Backend) -> Backend:
        """The backend that starts where this search ends."""
        return SearchedBackend(backend, self)


class SearchedBackend(Backend):
    """A backend behind a search. It prepares, merges and aligns as the backend does, but aligns
    from another start, whose cost is part of its ``seconds``."""

    def __init__(self, backend: Backend, search: Search) -> None:
        super().__init__(backend.max_correspondence_distance, backend.voxel_size)
        self.wrapped, self.search = backend, search
        self.requires = (*backend.requires, *search.requires)
        self.dimensions, self.uses_guess = backend.dimensions, backend.uses_guess

    def build(self, points: Array, planar: bool) -> Any:
        return self.wrapped.build(points, planar)

    def prepare(self, scan: Scan) -> Prepared:
        return self.wrapped.prepare(scan)

    def merge(
        self, parts: Sequence[tuple[Prepared, Array]], voxel_size: float | None = None
    ) -> Prepared:
        thin = {} if voxel_size is None else {"voxel_size": voxel_size}  # a stranger's may not know
        return self.wrapped.merge(parts, **thin)

    def join(self, parts: Sequence[tuple[Prepared, Array]]) -> Prepared:
        return self.wrapped.join(parts)

    def running_map(self, limits: MapLimits) -> RunningMap | None:
        return self.wrapped.running_map(limits)

    def register(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        started = time.perf_counter()
        start = self.search.start(source, target, T_target_source)
        seconds = time.perf_counter() - started
        alignment = self.wrapped.register(source, target, start.T_target_source)
        return replace(
            alignment,
            seconds=seconds + alignment.seconds,
            search_seconds=seconds,
            search_score=start.score,
            search_peak_ratio=start.peak_ratio,
        )

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        return self.wrapped.align(source, target, T_target_source)
