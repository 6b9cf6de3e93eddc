"""What the runs of one process share, kept from one run to the next.

One data set is kept at a time; memory is bounded by ``memory_mb``.
"""

from __future__ import annotations

import atexit
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from rbtm_bench.backends.base import Backend
from rbtm_bench.core.kinds import Kind
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.odometry.method import Method, Work
from rbtm_bench.pairs.codec import context
from rbtm_bench.pairs.shared import KnownScores, Memory, SharedDataset, SharedWork
from rbtm_bench.pairs.store import PairStore
from rbtm_bench.pairs.watched import Watch, WatchedWork
from rbtm_bench.runs import assembly, first_part, replicate
from rbtm_bench.runs.declared import kind_of
from rbtm_bench.runs.first_part import Determined
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
        self._store = store
        self._bytes = memory_mb * 1e6
        self._data_key = ""
        self._plain: tuple[str, Dataset] | None = None
        self._shared: dict[str, Any] = {}
        self._watch: Watch | None = None
        """Of the run's foreign plug-ins; None if all are ours."""

    def parts(self, settings: Settings) -> assembly.Parts:
        """The run's plug-ins and its work, shared where that changes nothing but the time."""
        dataset = self._dataset(settings.config)
        self._watch = dataset.watch
        if self._watch is not None:
            self._watch.begin()
        if self._store is not None:
            self._store.hold(self._watch is not None)
        assembly.check_fit(settings, dataset.plain)
        determined = self._determined(settings.config, dataset)
        config = first_part.filled(settings.config, determined.values)
        config = replicate.with_moved(config, dataset)
        metrics = assembly.build_metrics(config)
        if is_system(config):  # it remembers, so nothing of it can be shared but the scans
            return assembly.Parts(dataset, assembly.build(config["backend"]), metrics)
        others = ("similarity", "selector", "check", "recovery", "target")
        node = assembly.backend_node(config)
        backend = self._once("backend", node, partial(assembly.build_backend, config))
        guess, guess_key = assembly.build(config["guess"]), None
        if guess.pure:
            guess_key = node_key(config["guess"], guess.needs_backend and node)
            guess = self._once("guess", guess_key, lambda: guess)
        method = Method(
            backend=backend,
            guess=guess,
            **assembly.loop_settings(config),
            **{group: assembly.build(config[group]) for group in others},
        )
        limits = {kind: self._bytes * share for kind, share in SHARES.items() if kind != "scans"}
        memory = self._once("memory", None, lambda: Memory(**limits))
        contexts = self._contexts(config, backend, dataset)
        scores = self._scores(config, method, dataset)
        work: Work = SharedWork(method, memory, self._store, contexts, scores, guess_key)
        if self._watch is not None:
            work = WatchedWork(work, self._watch)
        loops = assembly.build(config["loops"])
        return assembly.Parts(dataset, method, metrics, work, determined, loops)

    def flush(self) -> None:
        """Let other processes see what this one has computed."""
        if self._store is not None:
            self._store.flush()

    def forget(self) -> None:
        """Start anew: after a failed run the plug-ins that it used may be in any state. What a
        stranger's have computed in it is dropped, unwritten."""
        if self._watch is not None and self._store is not None:
            self._store.drop()
        self._shared.clear()
        self._data_key, self._plain = "", None

    def close(self) -> None:
        """Write what has not been written yet."""
        if self._store is not None:
            self._store.close()

    def _once(self, kind: str, node: Any, make: Callable[[], T]) -> T:
        key = f"{kind} {node_key(node)}"
        if key not in self._shared:
            self._shared[key] = make()
        shared: T = self._shared[key]
        return shared

    def _determined(self, config: dict[str, Any], dataset: SharedDataset) -> Determined:
        """What the settings leave to the data's first part, once for equal settings."""
        if is_system(config):
            return Determined({})
        nodes = [v for k, v in config.items() if k == "seed" or kind_of(k) is Kind.WHAT]
        make = lambda: first_part.determined(config, dataset, assembly.method_of)  # noqa: E731
        return self._once("determined", nodes, make)

    def _dataset(self, config: dict[str, Any]) -> SharedDataset:
        data_key = node_key(config["dataset"], replicate.drawn(config))
        if data_key != self._data_key:
            self._shared.clear()
            plain = replicate.copy_of(self._opened(config["dataset"]), config)
            limit = self._bytes * SHARES["scans"]
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
            self._plain = (key, assembly.build(node))
        return self._plain[1]

    def _contexts(
        self, config: dict[str, Any], backend: Backend, dataset: SharedDataset
    ) -> list[bytes]:
        """What tells the registrations of a data set and a backend from others. With strangers at
        work in this process, which may have changed anything, their names do as well."""
        node = assembly.backend_node(config)
        judged = config["judge_points"], config["judge_radius"]
        beside = sorted(foreign_modules(config) - foreign_modules(node))

        def make() -> list[bytes]:
            facts = dataset.fingerprint(), node, versions_of(backend.requires), *judged
            return [context(*facts), *([context(*facts, beside)] if beside else [])]

        return self._once("contexts", [node, *judged, beside], make)

    def _scores(
        self, config: dict[str, Any], method: Method, dataset: SharedDataset
    ) -> KnownScores | None:
        selector = method.selector
        if not selector.needs_scores:
            return None
        make = lambda: KnownScores(method.similarity, dataset)  # noqa: E731
        known = self._once("similarity", config["similarity"], make)
        if selector.window().keyframes is None:
            limit = self._bytes * (1.0 - sum(SHARES.values())) / (8 * len(dataset))
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
    if _own is not None:
        _own[1].close()
    _own = None


atexit.register(close_own)
