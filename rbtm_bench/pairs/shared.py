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
from typing import Any, Generic, TypeVar

import numpy as np

from rbtm_bench.backends.base import Backend, Prepared
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.types import Array, Node, RegistrationResult, Scan
from rbtm_bench.datasets.base import Dataset, Relations
from rbtm_bench.odometry import judge
from rbtm_bench.odometry.method import Method, Work, checked_scores
from rbtm_bench.pairs.codec import pair_key
from rbtm_bench.pairs.store import PairStore
from rbtm_bench.similarity.base import Descriptor, Similarity

T = TypeVar("T")

NATIVE_SHARE = 8
"""A prepared scan takes about this many times its points' bytes: clouds, normals, trees."""
RESULT_BYTES = 1000
"""A registration kept in memory, its key included (measured: 0.9 kB)."""
GUESS_BYTES = 500
CONSTANT = ("planar", "skipped", "readings", "suspicions")


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
    """A data set whose scans are read once, as far as memory allows. ``private``: whoever asks gets
    a copy, so that a plug-in which writes into it changes no other run."""

    def __init__(self, dataset: Dataset, limit: float, private: bool = False) -> None:
        self.plain, self.private = dataset, private
        self._scans: Bounded[Scan] = Bounded(limit)
        for name in (*CONSTANT, "has_beams", "has_odometry", "has_ground_truth", "dropped"):
            setattr(self, name, getattr(dataset, name))

    def __len__(self) -> int:
        return len(self.plain)

    def __getitem__(self, index: int) -> Scan:
        scan = self._scans.get(index)
        if scan is None:
            scan = self.plain[index]
            size = scan.points.nbytes + (0 if scan.ranges is None else scan.ranges.nbytes) + 1000
            self._scans.put(index, scan, size)
        return scan.copied() if self.private else scan

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
    ) -> None:
        """``common`` tells this data set and backend from others in ``store`` and in the memories
        ``scans`` and ``results``, which several backends share."""
        self.backend, self._store, self._common = backend, store, common
        self.scans, self.results = scans, results

    def prepare(self, scan: Scan) -> tuple[Prepared, float]:
        """As ``Work.prepare``."""
        key = (self._common, scan.index)
        known = self.scans.get(key)
        if known is not None:
            return known
        started = time.perf_counter()
        prepared = self.backend.prepare(scan)
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
        key = pair_key(self._common, target.key, source.key[0][0], T_target_source)
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
            return judge.register(self.backend, source, target, T_target_source)
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
        scans = (scan.without_truth() for scan in dataset)
        self._descriptors: Descriptor = np.stack([similarity.describe(scan) for scan in scans])
        self._describe_seconds = (time.perf_counter() - started) / max(1, len(dataset))
        self._band: Array = np.zeros((len(dataset), 0))
        self._score_seconds = 0.0

    def widen(self, width: int) -> None:
        """Have the scores of every scan with the ``width`` scans before it."""
        if self._similarity.needs_guess or width <= self._band.shape[1]:
            return
        started = time.perf_counter()
        band = self._similarity.band(self._descriptors, width + 1)
        self._band = checked_scores(self._similarity, band, (len(self._descriptors), width))
        self._score_seconds = (time.perf_counter() - started) / self._band.size

    def describe(self, scan: Scan) -> tuple[Descriptor, float]:
        """The scan's number, and what its descriptor took."""
        return np.array([scan.index]), self._describe_seconds

    def scores(
        self, window: Descriptor, descriptor: Descriptor, motions: Array | None = None
    ) -> tuple[Array, float]:
        """As ``Work.scores``, of what ``describe`` handed out."""
        scan, first, last = int(descriptor[0]), int(window[0, 0]), int(window[-1, 0])
        in_band = last < scan and scan - first <= self._band.shape[1]
        if in_band and last - first + 1 == len(window):
            seconds = self._score_seconds * len(window)
            return self._band[scan, scan - last - 1 : scan - first][::-1], seconds
        started = time.perf_counter()
        past, now = self._descriptors[window[:, 0]], self._descriptors[scan]
        if motions is not None and self._similarity.needs_guess:
            scores = self._similarity.scores_under(past, now, motions)
        else:
            scores = self._similarity.scores(past, now)
        seconds = time.perf_counter() - started
        return checked_scores(self._similarity, scores, (len(window),)), seconds


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

    def describe(self, scan: Scan) -> tuple[Descriptor, float]:
        return super().describe(scan) if self._scores is None else self._scores.describe(scan)

    def scores(
        self, window: Descriptor, descriptor: Descriptor, motions: Array | None
    ) -> tuple[Array, float]:
        if self._scores is None:
            return super().scores(window, descriptor, motions)
        return self._scores.scores(window, descriptor, motions)

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
