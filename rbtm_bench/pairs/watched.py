"""What a stranger's plug-ins are handed: copies, remembered by digest, so that a run whose plug-ins
write into what they are only to read is found out."""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rbtm_bench.backends.base import Prepared
from rbtm_bench.core.types import Array, Node, RegistrationResult, Scan
from rbtm_bench.odometry.method import Work
from rbtm_bench.selection.window import Window
from rbtm_bench.similarity.base import Descriptor

OVERHEAD = 500
"""Bytes that remembering an array takes, beside its own."""


class Watch:
    """The arrays that a run's plug-ins were handed, at most ``limit`` bytes of them at a time:
    older ones are looked at once more, and let go. ``changed`` names those written into."""

    def __init__(self, limit: float) -> None:
        self._limit, self._used = limit, 0.0
        self._handed: deque[tuple[str, Array, bytes]] = deque()
        self._known: set[str] = set()
        self._changed: dict[str, None] = {}

    def hand(self, name: str, array: Array) -> None:
        """Remember an array as it is now."""
        self._handed.append((name, array, _digest(array)))
        self._used += array.nbytes + OVERHEAD
        while self._used > self._limit:
            self._look()

    def hand_once(self, name: str, array: Array) -> None:
        """The same, unless one of this name is remembered already."""
        if name not in self._known:
            self._known.add(name)
            self.hand(name, array)

    def scan(self, scan: Scan) -> Scan:
        """A copy of a scan, for one who asks; remembered."""
        copy = scan.copied()
        for name, array in copy.arrays().items():
            self.hand(f"scan {scan.index}'s {name}", array)
        return copy

    def changed(self) -> list[str]:
        """The names of what was changed since ``begin``."""
        while self._handed:
            self._look()
        return list(self._changed)

    def begin(self) -> None:
        """A new run: forget what was handed to others."""
        self._handed.clear()
        self._known.clear()
        self._changed.clear()
        self._used = 0.0

    def _look(self) -> None:
        name, array, digest = self._handed.popleft()
        self._used -= array.nbytes + OVERHEAD
        if _digest(array) != digest:
            self._changed[name] = None


def _digest(array: Array) -> bytes:
    head = f"{array.dtype.str} {array.shape} ".encode()
    return hashlib.blake2b(head + np.ascontiguousarray(array).tobytes(), digest_size=16).digest()


class WatchedWork(Work):
    """Another's work, handed out as copies or, where plug-ins share the very thing, watched."""

    def __init__(self, work: Work, watch: Watch) -> None:
        super().__init__(work.method)
        self._work, self._watch = work, watch

    def prepare(self, scan: Scan) -> tuple[Prepared, float]:
        prepared, seconds = self._work.prepare(scan)
        self._watch.hand_once(f"scan {scan.index}'s prepared points", prepared.points)
        return prepared, seconds

    def describe(self, scans: Sequence[Scan]) -> tuple[Descriptor, float]:
        return self._work.describe(scans)

    def scores(
        self, window: Window, scan: int, descriptor: Descriptor, motions: Array | None
    ) -> tuple[Array, float]:
        moved = None if motions is None else motions.copy()
        scores, seconds = self._work.scores(window.copied(), scan, descriptor.copy(), moved)
        return scores.copy(), seconds

    def predict(self, model: Node, scan: Scan, recent: Sequence[Node]) -> Array:
        return self._work.predict(model, scan, recent).copy()

    def register(
        self, source: Prepared, target: Prepared, T_target_source: Array
    ) -> RegistrationResult:
        result = self._work.register(source, target, T_target_source.copy())
        information = result.information
        if information is not None:
            information = information.copy(order="K")
        T = result.T_target_source.copy(order="K")
        return replace(result, T_target_source=T, information=information)
