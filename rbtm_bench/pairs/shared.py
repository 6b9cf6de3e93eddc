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

from rbtm_bench.backends.base import Backend, Prepared
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.types import Array, Node, RegistrationResult, Scan, read_only
from rbtm_bench.datasets.base import ATTRIBUTES, Dataset, Relations
from rbtm_bench.odometry import checked, judge
from rbtm_bench.odometry.method import Method, Work
from rbtm_bench.pairs.codec import pair_key
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
        self.limit, self.used = limit, 0.0
        self._items: OrderedDict[Any, tuple[T, float]] = OrderedDict()

    def __len__(self) -> int:
        return len(self._items)

    def get(self, key: Any) -> T | None:
        """The item, or None; it is now the most recently used."""
        entry = self._items.get(key)
        if entry is None:
            return None
        self._items.move_to_end(key)
        return entry[0]

    def put(self, key: Any, item: T, size: float) -> T:
        """Keep an item of ``size`` bytes, at the cost of older ones."""
        self._items[key] = (item, size)
        self.used += size
        while self.used > self.limit and len(self._items) > 1:
            self.used -= self._items.popitem(last=False)[1][1]
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

    def __iter__(self) -> Iterator[Scan]:
        for index in range(len(self)):
            yield self[index]

    def fingerprint(self) -> str:
        return self.plain.fingerprint()

    @property
    def relations(self) -> Relations | None:
        return self.plain.relations


class KnownRegistrations:
    """A backend's prepared scans and registrations of one data set: each computed once."""

    def __init__(
        self,
        backend: Backend,
        store: PairStore | None,
        common: bytes,
        scans: Bounded[tuple[Prepared, float]],
        results: Bounded[RegistrationResult | BackendError],
        judge_points: int = judge.MAX_POINTS,
        own: bytes | None = None,
        judge_radius: float | None = None,
    ) -> None:
        """``common`` tells this data set, backend and ``judge_...`` from others in ``store``
        and in the memories ``scans`` and ``results``, which several backends share. With ``own``,
        which tells strangers in this process apart as well, new pairs are stored under that."""
        self.backend, self._store, self._common, self._own = backend, store, common, own
        self.scans, self.results = scans, results
        self._judge_points, self._judge_radius = judge_points, judge_radius

    def prepare(self, scan: Scan) -> tuple[Prepared, float]:
        """As ``Work.prepare``."""
        key = (self._common, scan.index)
        known = self.scans.get(key)
        if known is not None:
            return known
        started = time.perf_counter()
        prepared = checked.prepared(self.backend, scan)
        seconds = time.perf_counter() - started
        size = prepared.points.nbytes * NATIVE_SHARE + 2000
        return self.scans.put(key, (prepared, seconds), size)

    def register(
        self, source: Prepared, target: Prepared, T_target_source: Array
    ) -> RegistrationResult:
        """As ``Work.register``; the result says whether it was reused."""
        key = (self._common, source.key, target.key, T_target_source.tobytes())
        outcome = self.results.get(key)
        if outcome is None:
            outcome = self._stored_or_new(source, target, T_target_source)
            self.results.put(key, _reused(outcome), RESULT_BYTES)
        if isinstance(outcome, BackendError):
            raise BackendError(str(outcome))  # a new one: a raised error keeps its frames alive
        return outcome

    def _stored_or_new(
        self, source: Prepared, target: Prepared, T_target_source: Array
    ) -> RegistrationResult | BackendError:
        if self._store is None:
            return self._compute(source, target, T_target_source)
        content = source.digest + target.digest
        pair = (target.key, source.key[0][0], T_target_source, content)
        key = pair_key(self._common, *pair)
        known = self._store.get(key)
        if known is None and self._own is not None:
            key = pair_key(self._own, *pair)
            known = self._store.get(key)
        if known is not None:
            return _reused(known)
        outcome = self._compute(source, target, T_target_source)
        self._store.put(key, outcome)
        return outcome

    def _compute(
        self, source: Prepared, target: Prepared, T_target_source: Array
    ) -> RegistrationResult | BackendError:
        try:
            most, radius = self._judge_points, self._judge_radius
            return judge.register(self.backend, source, target, T_target_source, most, radius)
        except BackendError as error:
            return error.with_traceback(None)


def _reused(outcome: RegistrationResult | BackendError) -> RegistrationResult | BackendError:
    """The outcome as whoever asks again gets it."""
    return outcome if isinstance(outcome, BackendError) else replace(outcome, reused=True)


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
    ``scores`` and ``guesses`` are None where nothing of that kind can be shared."""

    def __init__(
        self,
        method: Method,
        registrations: KnownRegistrations,
        scores: KnownScores | None,
        guesses: Bounded[Array] | None,
    ) -> None:
        super().__init__(method)
        self._registrations, self._scores, self._guesses = registrations, scores, guesses

    def prepare(self, scan: Scan) -> tuple[Prepared, float]:
        return self._registrations.prepare(scan)

    def describe(self, scans: Sequence[Scan]) -> tuple[Descriptor, float]:
        return super().describe(scans) if self._scores is None else self._scores.describe(scans)

    def scores(
        self, window: Window, scan: int, descriptor: Descriptor, motions: Array | None
    ) -> tuple[Array, float]:
        if self._scores is None:
            return super().scores(window, scan, descriptor, motions)
        return self._scores.scores(window, scan, motions)

    def predict(self, model: Node, scan: Scan, recent: Sequence[Node]) -> Array:
        if self._guesses is None:
            return super().predict(model, scan, recent)
        known = self._guesses.get((model.scan, scan.index))
        if known is None:
            motion = super().predict(model, scan, recent)
            known = self._guesses.put((model.scan, scan.index), motion, GUESS_BYTES)
        return known

    def register(
        self, source: Prepared, target: Prepared, T_target_source: Array
    ) -> RegistrationResult:
        return self._registrations.register(source, target, T_target_source)
