"""What the runs of one process share: scans, prepared scans, descriptors, scores, registrations.

A sweep asks for the same things again and again. The workbench gives a run plug-ins that look
like the plain ones and answer from memory (and, for registrations, from the pair store) where
they can, with the same bits. One data set is kept at a time; memory is bounded by ``memory_mb``.
"""

from __future__ import annotations

import atexit
import json
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from rbtm_bench.backends.base import Alignment, Backend, Prepared, TargetKey
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.types import Array, Node, RegistrationResult, Scan
from rbtm_bench.datasets.base import Dataset, Relations
from rbtm_bench.guess.base import Guess
from rbtm_bench.odometry.loop import Method
from rbtm_bench.pairs.store import PairStore, context, pair_key
from rbtm_bench.runs import experiment
from rbtm_bench.runs.provenance import versions_of
from rbtm_bench.runs.settings import Settings, is_system
from rbtm_bench.selection.base import Selector
from rbtm_bench.similarity.base import Descriptor, Similarity

T = TypeVar("T")

NATIVE_SHARE = 8
"""A prepared scan takes about this many times its points' bytes: clouds, normals, trees."""
RESULT_BYTES = 1000
"""A registration kept in memory, its key included (measured: 0.9 kB)."""
GUESS_BYTES = 500
SHARES = {"scans": 0.15, "prepared": 0.5, "results": 0.2, "guesses": 0.05}
"""How ``memory_mb`` is divided; the rest is for descriptors and scores."""


class Bounded(Generic[T]):
    """A dictionary that forgets the least recently used items beyond ``limit`` bytes."""

    def __init__(self, limit: float) -> None:
        self.limit, self.used = limit, 0.0
        self._items: OrderedDict[Any, tuple[T, float]] = OrderedDict()

    def __len__(self) -> int:
        return len(self._items)

    def get(self, key: Any) -> T | None:
        """The item, or None; it is now the most recently used."""
        found = self._items.get(key)
        if found is None:
            return None
        self._items.move_to_end(key)
        return found[0]

    def put(self, key: Any, item: T, size: float) -> T:
        """Keep an item of ``size`` bytes, at the cost of older ones."""
        self._items[key] = (item, size)
        self.used += size
        while self.used > self.limit and len(self._items) > 1:
            self.used -= self._items.popitem(last=False)[1][1]
        return item


class Workbench:
    """Everything that a process keeps between runs. ``store`` may be None: memory alone."""

    def __init__(self, store: PairStore | None = None, memory_mb: float = 1000.0) -> None:
        self.store = store
        self.bytes = memory_mb * 1e6
        self._data_key = ""
        self._shared: dict[str, Any] = {}

    def parts(self, settings: Settings) -> experiment.Parts:
        """The run's plug-ins, shared ones where that changes nothing but the time."""
        config = settings.config
        data_key = _key(config["dataset"])
        if data_key != self._data_key:
            self._shared.clear()
            self._shared["dataset"] = SharedDataset(
                experiment.build(config["dataset"]), self.bytes * SHARES["scans"]
            )
            self._data_key = data_key
        dataset: SharedDataset = self._shared["dataset"]
        experiment.check_fit(settings, dataset.plain)
        metrics = experiment.build_metrics(config)
        if is_system(config):  # it remembers, so nothing of it can be shared but the scans
            return experiment.Parts(dataset, experiment.build(config["backend"]), metrics)
        plain = {g: experiment.build(config[g]) for g in ("selector", "check", "target")}
        backend = self._once("backend", config["backend"], self._backend(config, dataset))
        method = Method(
            backend=backend,
            similarity=self._similarity(config, dataset, plain["selector"]),
            guess=self._guess(config),
            guess_along_degenerate=config["guess_along_degenerate"],
            **plain,
        )
        return experiment.Parts(dataset, method, metrics)

    def flush(self) -> None:
        """Let other processes see what this one has computed."""
        if self.store is not None:
            self.store.flush()

    def forget(self) -> None:
        """Start anew: after a failed run the plug-ins that it used may be in any state."""
        self._shared.clear()
        self._data_key = ""

    def _once(self, kind: str, node: Any, make: Callable[[], T]) -> T:
        key = f"{kind} {_key(node)}"
        if key not in self._shared:
            self._shared[key] = make()
        shared: T = self._shared[key]
        return shared

    def _backend(self, config: dict[str, Any], dataset: Dataset) -> Callable[[], SharedBackend]:
        def make() -> SharedBackend:
            backend: Backend = experiment.build(config["backend"])
            versions = versions_of(backend.requires)
            common = context(dataset.fingerprint(), config["backend"], versions)
            # several backends take turns on one data set: the bound is for all of them
            kept = [b for b in self._shared.values() if isinstance(b, SharedBackend)]
            memory = (
                kept[0].memory
                if kept
                else (
                    Bounded[Prepared](self.bytes * SHARES["prepared"]),
                    Bounded[RegistrationResult | BackendError](self.bytes * SHARES["results"]),
                )
            )
            return SharedBackend(backend, self.store, common, memory)

        return make

    def _similarity(
        self, config: dict[str, Any], dataset: Dataset, selector: Selector
    ) -> Similarity:
        node = config["similarity"]
        if not selector.needs_scores:
            plain: Similarity = experiment.build(node)
            return plain
        shared = self._once(
            "similarity", node, lambda: SharedSimilarity(experiment.build(node), dataset)
        )
        if selector.window().keyframes is None:
            limit = self.bytes * (1.0 - sum(SHARES.values())) / (8 * len(dataset))
            shared.widen(min(selector.capacity, int(limit)))
        return shared

    def _guess(self, config: dict[str, Any]) -> Guess:
        guess: Guess = experiment.build(config["guess"])
        if not guess.pure:
            return guess
        node = [config["guess"], config["backend"] if guess.needs_backend else None]
        return self._once("guess", node, lambda: SharedGuess(guess, self.bytes * SHARES["guesses"]))


_own: tuple[tuple[Any, ...], Workbench] | None = None


def own_workbench(settings: Settings) -> Workbench | None:
    """This process's workbench for the pair store that the settings name, kept between runs.

    None where nothing is to be shared: ``pairs.store=off``, or no folder for the store.
    """
    global _own
    pairs = settings.config["pairs"]
    if pairs["store"] == "off" or pairs["folder"] is None:
        return None
    wanted = (pairs["folder"], pairs["store"], pairs["memory_mb"])
    if _own is None or _own[0] != wanted:
        close_own()
        store = PairStore(Path(pairs["folder"]), pairs["store"])
        _own = (wanted, Workbench(store, pairs["memory_mb"]))
    return _own[1]


def close_own() -> None:
    """Write what this process's workbench has not written yet, and forget it."""
    global _own
    if _own is not None and _own[1].store is not None:
        _own[1].store.close()
    _own = None


atexit.register(close_own)


class SharedDataset(Dataset):
    """A data set whose scans are read once, as far as memory allows."""

    def __init__(self, dataset: Dataset, limit: float) -> None:
        self.plain = dataset
        self._scans: Bounded[Scan] = Bounded(limit)
        for name in ("planar", "has_beams", "has_odometry", "has_ground_truth", "skipped"):
            setattr(self, name, getattr(dataset, name))

    def __len__(self) -> int:
        return len(self.plain)

    def __getitem__(self, index: int) -> Scan:
        scan = self._scans.get(index)
        if scan is None:
            scan = self.plain[index]
            size = scan.points.nbytes + (0 if scan.ranges is None else scan.ranges.nbytes) + 1000
            self._scans.put(index, scan, size)
        return scan

    def __iter__(self) -> Iterator[Scan]:
        for index in range(len(self)):
            yield self[index]

    def fingerprint(self) -> str:
        return self.plain.fingerprint()

    @property
    def relations(self) -> Relations | None:
        return self.plain.relations


class SharedBackend(Backend):
    """A backend that prepares a scan once and registers a pair once for each initial guess."""

    def __init__(
        self,
        backend: Backend,
        store: PairStore | None,
        common: bytes,
        memory: tuple[Bounded[Prepared], Bounded[RegistrationResult | BackendError]],
    ) -> None:
        super().__init__(backend.max_correspondence_distance, backend.voxel_size)
        self._backend, self._store, self._common = backend, store, common
        self.memory = memory
        self._scans, self._results = memory

    def build(self, points: Array, planar: bool) -> Any:
        return self._backend.build(points, planar)

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        return self._backend.align(source, target, T_target_source)

    def prepare(self, scan: Scan) -> Prepared:
        key = (self._common, scan.index)
        prepared = self._scans.get(key)
        if prepared is not None:
            self.saved_seconds = prepared.seconds
            return prepared
        prepared = self._backend.prepare(scan)
        return self._scans.put(key, prepared, prepared.points.nbytes * NATIVE_SHARE + 2000)

    def merge(self, parts: Sequence[tuple[Prepared, Array]]) -> Prepared:
        return self._backend.merge(parts)

    def register(
        self, source: Prepared, target: Prepared, T_target_source: Array
    ) -> RegistrationResult:
        key = (self._common, source.key, target.key, T_target_source.tobytes())
        outcome = self._results.get(key)
        if outcome is None:
            outcome = self._stored_or_new(source, target, T_target_source)
            again = (
                replace(outcome, reused=True)
                if isinstance(outcome, RegistrationResult)
                else outcome
            )
            self._results.put(key, again, RESULT_BYTES)
        if isinstance(outcome, BackendError):
            raise BackendError(str(outcome))  # a new one: a raised error keeps its frames alive
        return outcome

    def _stored_or_new(
        self, source: Prepared, target: Prepared, T_target_source: Array
    ) -> RegistrationResult | BackendError:
        if self._store is None:
            return self._compute(source, target, T_target_source)
        key = pair_key(self._common, target.key, _number(source.key), T_target_source)
        found = self._store.get(key)
        if found is not None:
            return found if isinstance(found, BackendError) else replace(found, reused=True)
        outcome = self._compute(source, target, T_target_source)
        self._store.put(key, outcome)
        return outcome

    def _compute(
        self, source: Prepared, target: Prepared, T_target_source: Array
    ) -> RegistrationResult | BackendError:
        try:
            return self._backend.register(source, target, T_target_source)
        except BackendError as error:
            return error.with_traceback(None)


class SharedSimilarity(Similarity):
    """A similarity whose descriptors and scores of a whole data set are computed once.

    What it hands out as a scan's descriptor is the scan's number; scores of consecutive scans are
    looked up in the band, all others computed from the descriptors. Scores under a guess, which
    may differ from run to run, are computed every time.
    """

    def __init__(self, similarity: Similarity, dataset: Dataset) -> None:
        self._similarity = similarity
        self.needs_guess = similarity.needs_guess
        started = time.perf_counter()
        scans = (scan.without_truth() for scan in dataset)
        self._descriptors: Descriptor = np.stack([similarity.describe(scan) for scan in scans])
        self._describe_seconds = (time.perf_counter() - started) / max(1, len(dataset))
        self._band: Array = np.zeros((len(dataset), 0))
        self._score_seconds = 0.0

    def widen(self, width: int) -> None:
        """Have the scores of every scan with the ``width`` scans before it."""
        if self.needs_guess or width <= self._band.shape[1]:
            return
        started = time.perf_counter()
        self._band = self._similarity.band(self._descriptors, width + 1)
        self._score_seconds = (time.perf_counter() - started) / self._band.size

    def describe(self, scan: Scan) -> Descriptor:
        self.saved_seconds = self._describe_seconds
        return np.array([scan.index])

    def scores(self, window: Descriptor, descriptor: Descriptor) -> Array:
        scan, first, last = int(descriptor[0]), int(window[0, 0]), int(window[-1, 0])
        in_band = last < scan and scan - first <= self._band.shape[1]
        if in_band and last - first + 1 == len(window):
            self.saved_seconds = self._score_seconds * len(window)
            return self._band[scan, scan - last - 1 : scan - first][::-1]
        return self._similarity.scores(self._descriptors[window[:, 0]], self._descriptors[scan])

    def scores_under(self, window: Descriptor, descriptor: Descriptor, motions: Array) -> Array:
        if not self.needs_guess:
            return self.scores(window, descriptor)
        known = self._descriptors
        return self._similarity.scores_under(known[window[:, 0]], known[descriptor[0]], motions)

    def pairwise(self, rows: Descriptor, columns: Descriptor) -> Array:
        known = self._descriptors
        return self._similarity.pairwise(known[rows[:, 0]], known[columns[:, 0]])

    def matrix(self, descriptors: Descriptor) -> Array:
        return self._similarity.matrix(self._descriptors[descriptors[:, 0]])


class SharedGuess(Guess):
    """A pure guess, computed once a pair."""

    def __init__(self, guess: Guess, limit: float) -> None:
        self._guess = guess
        self.pure, self.needs_odometry = guess.pure, guess.needs_odometry
        self._known: Bounded[Array] = Bounded(limit)

    def observe(self, scan: Scan, prepared: Prepared | None, backend: Backend) -> float:
        return self._guess.observe(scan, prepared, backend)

    def predict(self, model: Node, scan: Scan, recent: Sequence[Node]) -> Array:
        key = (model.scan, scan.index)
        known = self._known.get(key)
        if known is None:
            motion = self._guess.predict(model, scan, recent)
            known = self._known.put(key, motion, GUESS_BYTES)
        return known


def _number(key: TargetKey) -> int:
    return key[0][0]


def _key(node: Any) -> str:
    return json.dumps(node, sort_keys=True, default=str)
