"""Work that is done once and shared: scans, prepared scans, descriptors, scores, registrations.

A sweep asks for the same things again and again. ``SharedWork`` answers from memory (and, for
registrations, from the pair store) where it can, with the same bits as ``odometry.method.Work``,
each answer with the seconds that its computation took.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from typing import Any, Generic, TypeVar

import numpy as np

from rbtm_bench.backends.base import Prepared
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.types import Array, Node, RegistrationResult, Scan, read_only
from rbtm_bench.datasets.base import ATTRIBUTES, Dataset, Relations
from rbtm_bench.odometry import checked
from rbtm_bench.odometry.method import Method, Work
from rbtm_bench.pairs.codec import Outcome, pair_key
from rbtm_bench.pairs.store import PairStore
from rbtm_bench.pairs.watched import Watch
from rbtm_bench.selection.window import Window
from rbtm_bench.similarity.band import Band
from rbtm_bench.similarity.base import BLOCK, Descriptor, Similarity, checked_scores

T = TypeVar("T")

NATIVE_SHARE = 8
"""A prepared scan takes about this many times its points' bytes: clouds, normals, trees."""
RESULT_BYTES = 1000
"""A registration kept in memory, its key included (measured: 0.9 kB)."""
GUESS_BYTES = 500


class Bounded(Generic[T]):
    """A dictionary that forgets the least recently used items beyond ``limit`` bytes."""

    def __init__(self, limit: float) -> None:
        self._limit, self._used = limit, 0.0
        self._items: OrderedDict[Any, tuple[T, float]] = OrderedDict()

    def get(self, key: Any) -> T | None:
        """The item, or None; it is now the most recently used."""
        if key not in self._items:
            return None
        self._items.move_to_end(key)
        return self._items[key][0]

    def put(self, key: Any, item: T, size: float) -> T:
        """Keep an item of ``size`` bytes, at the cost of older ones."""
        self._items[key] = (item, size)
        self._used += size
        while self._used > self._limit and len(self._items) > 1:
            self._used -= self._items.popitem(last=False)[1][1]
        return item


class SharedDataset(Dataset):
    """A data set whose scans are read once, as far as memory allows, and handed out read-only; or,
    with a ``watch``, as copies that it remembers: a stranger's library may refuse such arrays."""

    def __init__(self, dataset: Dataset, limit: float, watch: Watch | None = None) -> None:
        self.plain, self.watch = dataset, watch
        self._scans: Bounded[Scan] = Bounded(limit)
        self._angles: tuple[Array | None, Array | None] = (None, None)
        for name in ATTRIBUTES:
            setattr(self, name, getattr(dataset, name))

    def __len__(self) -> int:
        return len(self.plain)

    def __getitem__(self, index: int) -> Scan:
        scan = self._scans.get(index)
        if scan is None:
            scan = self.plain[index]
            if scan.angles is not self._angles[0]:  # one view for all: who looks for a change of
                view = None if scan.angles is None else read_only(scan.angles)  # beams sees none
                self._angles = (scan.angles, view)
            scan = replace(scan, angles=self._angles[1]).read_only()
            size = scan.points.nbytes + (0 if scan.ranges is None else scan.ranges.nbytes) + 1000
            self._scans.put(index, scan, size)
        return scan if self.watch is None else self.watch.scan(scan)

    def fingerprint(self) -> str:
        return self.plain.fingerprint()

    @property
    def relations(self) -> Relations | None:
        return self.plain.relations


class Memory:
    """What a process keeps of one data set, each kind within its bound of bytes."""

    def __init__(self, prepared: float, results: float, guesses: float) -> None:
        self.prepared: Bounded[tuple[Prepared, float]] = Bounded(prepared)
        self.results: Bounded[Outcome] = Bounded(results)
        self.guesses: Bounded[Array] = Bounded(guesses)


class KnownScores:
    """The descriptors and scores of a whole data set, computed once.

    What it hands out as a scan's descriptor is the scan's number; scores of consecutive scans are
    looked up in the band, all others computed from the descriptors. Scores under a guess, which
    may differ from run to run, are computed every time.
    """

    def __init__(self, similarity: Similarity, dataset: Dataset) -> None:
        self._similarity = similarity
        started = time.perf_counter()
        self._descriptors: Descriptor = np.concatenate(
            [checked.descriptors(similarity, block) for block in _blocks_of(dataset)]
        )
        self._describe_seconds = (time.perf_counter() - started) / max(1, len(dataset))
        self._band = Band(similarity, 0)
        self._score_seconds = 0.0

    def widen(self, width: int) -> None:
        """Have the scores of every scan with the ``width`` scans before it."""
        if self._similarity.needs_guess or width <= self._band.width:
            return
        started = time.perf_counter()
        self._band = Band(self._similarity, width)
        self._band.extend(np.arange(len(self._descriptors)), self._descriptors)
        self._score_seconds = (time.perf_counter() - started) / len(self._descriptors) / width

    def describe(self, scans: Sequence[Scan]) -> tuple[Descriptor, float]:
        """The scans' numbers (N, 1), and what a scan's descriptor took."""
        return np.array([[scan.index] for scan in scans]), self._describe_seconds

    def scores(
        self, window: Window, scan: int, motions: Array | None = None
    ) -> tuple[Array, float]:
        """As ``Work.scores``, of what ``describe`` handed out."""
        known = self._band.scores(window.scans, scan)
        if known is not None:
            return known, self._score_seconds * len(window)
        started = time.perf_counter()
        past, now = self._descriptors[window.descriptors[:, 0]], self._descriptors[scan]
        if motions is not None and self._similarity.needs_guess:
            scores = self._similarity.scores_under(past, now, motions)
        else:
            scores = self._similarity.scores(past, now)
        seconds = time.perf_counter() - started
        return checked_scores(self._similarity, scores, (len(window),)), seconds


def _blocks_of(dataset: Dataset) -> Iterator[list[Scan]]:
    """All scans, without truth, a block at a time."""
    scans = (scan.without_truth() for scan in dataset)
    while block := list(islice(scans, BLOCK)):
        yield block


class SharedWork(Work):
    """A run's work, answered from what earlier runs of the process, or of others, have computed.

    ``contexts`` tell this data set and backend from others; registrations known under any of them
    are answers, new ones are kept under the last. ``scores`` and ``guess_key`` are None where
    nothing of that kind can be shared.
    """

    def __init__(
        self,
        method: Method,
        memory: Memory,
        store: PairStore | None,
        contexts: Sequence[bytes],
        scores: KnownScores | None,
        guess_key: str | None,
    ) -> None:
        super().__init__(method)
        self._memory, self._store, self._contexts = memory, store, contexts
        self._scores, self._guess_key = scores, guess_key

    def prepare(self, scan: Scan) -> tuple[Prepared, float]:
        key = (self._contexts[-1], scan.index)
        known = self._memory.prepared.get(key)
        if known is None:
            known = super().prepare(scan)
            size = known[0].points.nbytes * NATIVE_SHARE + 2000
            self._memory.prepared.put(key, known, size)
        return known

    def describe(self, scans: Sequence[Scan]) -> tuple[Descriptor, float]:
        return super().describe(scans) if self._scores is None else self._scores.describe(scans)

    def scores(
        self, window: Window, scan: int, descriptor: Descriptor, motions: Array | None
    ) -> tuple[Array, float]:
        if self._scores is None:
            return super().scores(window, scan, descriptor, motions)
        return self._scores.scores(window, scan, motions)

    def predict(self, model: Node, scan: Scan, recent: Sequence[Node]) -> Array:
        if self._guess_key is None:
            return super().predict(model, scan, recent)
        key = (self._guess_key, model.scan, scan.index)
        known = self._memory.guesses.get(key)
        if known is None:
            motion = super().predict(model, scan, recent)
            known = self._memory.guesses.put(key, motion, GUESS_BYTES)
        return known

    def register(
        self, source: Prepared, target: Prepared, T_target_source: Array
    ) -> RegistrationResult:
        if len(target.key) > 1:  # placed by the run's own estimates: nobody else asks for it
            return super().register(source, target, T_target_source)
        key = (self._contexts[-1], source.key, target.key, T_target_source.tobytes())
        outcome = self._memory.results.get(key)
        if outcome is None:
            outcome = self._stored_or_new(source, target, T_target_source)
            again = outcome if isinstance(outcome, BackendError) else replace(outcome, reused=True)
            self._memory.results.put(key, again, RESULT_BYTES)
        if isinstance(outcome, BackendError):
            raise BackendError(str(outcome))  # a new one: a raised error keeps its frames alive
        return outcome

    def _stored_or_new(self, source: Prepared, target: Prepared, T_target_source: Array) -> Outcome:
        if self._store is None:
            return self._computed(source, target, T_target_source)
        pair = target.key, source.key[0][0], T_target_source, source.digest + target.digest
        for context in self._contexts:
            key = pair_key(context, *pair)
            known = self._store.get(key)
            if known is not None:
                return known
        outcome = self._computed(source, target, T_target_source)
        self._store.put(key, outcome)
        return outcome

    def _computed(self, source: Prepared, target: Prepared, T_target_source: Array) -> Outcome:
        try:
            return super().register(source, target, T_target_source)
        except BackendError as error:
            return error.with_traceback(None)
