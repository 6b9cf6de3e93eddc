"""What the runs of one process share, kept from one run to the next.

One data set is kept at a time; memory is bounded by ``memory_mb``.
"""

from __future__ import annotations

import atexit
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from rbtm_bench.backends.base import Prepared
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.types import Array, RegistrationResult
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.odometry.method import Method, Work
from rbtm_bench.pairs.codec import context
from rbtm_bench.pairs.shared import (
    Bounded,
    KnownRegistrations,
    KnownScores,
    SharedDataset,
    SharedWork,
)
from rbtm_bench.pairs.store import PairStore
from rbtm_bench.pairs.watched import Watch, WatchedWork
from rbtm_bench.runs import experiment, replicate
from rbtm_bench.runs.identity import node_key
from rbtm_bench.runs.plugins import foreign_modules, is_system
from rbtm_bench.runs.provenance import versions_of
from rbtm_bench.runs.settings import Settings

T = TypeVar("T")

SHARES = {"scans": 0.15, "prepared": 0.5, "results": 0.2, "guesses": 0.05}
"""How ``memory_mb`` is divided; the rest is for descriptors and scores."""


class Workbench:
    """Everything that a process keeps between runs. ``store`` may be None: memory alone."""

    def __init__(self, store: PairStore | None = None, memory_mb: float = 1000.0) -> None:
        self.store = store
        self.bytes = memory_mb * 1e6
        self._data_key = ""
        self._plain: tuple[str, Dataset] | None = None
        self._shared: dict[str, Any] = {}
        self._watch: Watch | None = None
        """Of the run's foreign plug-ins; None if all are ours."""

    def parts(self, settings: Settings) -> experiment.Parts:
        """The run's plug-ins and its work, shared where that changes nothing but the time."""
        dataset = self._dataset(settings.config)
        self._watch = dataset.watch
        if self._watch is not None:
            self._watch.begin()
        if self.store is not None:
            self.store.held = self._watch is not None
        experiment.check_fit(settings, dataset.plain)
        config = replicate.with_moved(settings.config, dataset)
        metrics = experiment.build_metrics(config)
        if is_system(config):  # it remembers, so nothing of it can be shared but the scans
            return experiment.Parts(dataset, experiment.build(config["backend"]), metrics)
        loops = experiment.build(config["loops"])
        plain = {g: experiment.build(config[g]) for g in ("selector", "check", "target")}
        judged = [experiment.backend_node(config), config["judge_points"]]
        known = self._once("backend", judged, lambda: self._backend(config, dataset))
        guess_node = [config["guess"]]
        guess = experiment.build(config["guess"])
        if guess.pure:
            guess_node += [experiment.backend_node(config)] if guess.needs_backend else []
            guess = self._once("guess", guess_node, lambda: guess)
        method = Method(
            backend=known.backend,
            similarity=experiment.build(config["similarity"]),
            guess=guess,
            guess_along_degenerate=config["guess_along_degenerate"],
            judge_points=config["judge_points"],
            edges_from=loops.covariance_from,
            **plain,
        )
        guesses = None
        if guess.pure:
            limit = self.bytes * SHARES["guesses"]
            guesses = self._once("guesses", guess_node, lambda: Bounded[Array](limit))
        work: Work = SharedWork(method, known, self._scores(config, method, dataset), guesses)
        if self._watch is not None:
            work = WatchedWork(work, self._watch)
        return experiment.Parts(dataset, method, metrics, work, loops)

    def flush(self) -> None:
        """Let other processes see what this one has computed."""
        if self.store is not None:
            self.store.flush()

    def forget(self) -> None:
        """Start anew: after a failed run the plug-ins that it used may be in any state. What a
        stranger's have computed in it is dropped, unwritten."""
        if self._watch is not None and self.store is not None:
            self.store.drop()
        self._shared.clear()
        self._data_key, self._plain = "", None

    def _once(self, kind: str, node: Any, make: Callable[[], T]) -> T:
        key = f"{kind} {node_key(node)}"
        if key not in self._shared:
            self._shared[key] = make()
        shared: T = self._shared[key]
        return shared

    def _dataset(self, config: dict[str, Any]) -> SharedDataset:
        data_key = node_key(config["dataset"], replicate.drawn(config))
        if data_key != self._data_key:
            self._shared.clear()
            plain = replicate.copy_of(self._opened(config["dataset"]), config)
            limit = self.bytes * SHARES["scans"]
            watch = Watch(limit) if foreign_modules(config) else None
            self._shared["dataset"] = SharedDataset(plain, limit, watch)
            self._data_key = data_key
        dataset: SharedDataset = self._shared["dataset"]
        return dataset

    def _opened(self, node: dict[str, Any]) -> Dataset:
        """The data set of a config, opened once for all replicates."""
        key = node_key(node)
        if self._plain is None or self._plain[0] != key:
            self._plain = None  # before the next: one in memory at a time
            self._plain = (key, experiment.build(node))
        return self._plain[1]

    def _backend(self, config: dict[str, Any], dataset: SharedDataset) -> KnownRegistrations:
        backend, node = experiment.build_backend(config), experiment.backend_node(config)
        most = config["judge_points"]
        versions = versions_of(backend.requires)
        facts = dataset.fingerprint(), node, versions, most
        # what else is at work in this process may have changed anything: its own pairs alone
        beside = sorted(foreign_modules(config) - foreign_modules(node))
        common, own = context(*facts), context(*facts, *beside) if beside else None
        # several backends take turns on one data set: the bound is for all of them
        others = [one for one in self._shared.values() if isinstance(one, KnownRegistrations)]
        if others:
            scans, results = others[0].scans, others[0].results
        else:
            scans = Bounded[tuple[Prepared, float]](self.bytes * SHARES["prepared"])
            results = Bounded[RegistrationResult | BackendError](self.bytes * SHARES["results"])
        return KnownRegistrations(backend, self.store, common, scans, results, most, own)

    def _scores(
        self, config: dict[str, Any], method: Method, dataset: SharedDataset
    ) -> KnownScores | None:
        selector = method.selector
        if not selector.needs_scores:
            return None
        make = lambda: KnownScores(method.similarity, dataset)  # noqa: E731
        known = self._once("similarity", config["similarity"], make)
        if selector.window().keyframes is None:
            limit = self.bytes * (1.0 - sum(SHARES.values())) / (8 * len(dataset))
            known.widen(min(selector.capacity, int(limit)))
        return known


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
