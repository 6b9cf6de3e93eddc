"""The loop: describe, select, register, check, update, record. Nothing here knows files."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rbtm_bench.backends.base import Backend, Prepared
from rbtm_bench.check.base import Check
from rbtm_bench.degeneracy import remap, unseen
from rbtm_bench.errors import BackendError
from rbtm_bench.guess.base import Guess
from rbtm_bench.selection.base import Candidate, Selection, Selector
from rbtm_bench.selection.window import Window
from rbtm_bench.similarity.base import Descriptor, Similarity
from rbtm_bench.target import Target
from rbtm_bench.trajectory import PoseChain
from rbtm_bench.types import Edge, Node, RegistrationResult, Scan, Step, StepRecord


@dataclass(frozen=True)
class Method:
    """What is compared: a backend, a way to choose the model scan, and what goes with them."""

    backend: Backend
    similarity: Similarity
    selector: Selector
    guess: Guess
    check: Check
    target: Target
    guess_along_degenerate: float | None = None
    """Keep the guess along directions of less localizability than this; None: never."""


def odometry(scans: Iterable[Scan], method: Method) -> Iterator[Step]:
    """Register a stream of scans, one at a time, and yield what became of each.

    The first scan is the origin. Memory is bounded by the selector's window (and the poses).
    A scan for which no registration is accepted keeps its predicted pose and says so.
    """
    window = method.selector.window()
    chain = PoseChain()
    recent: deque[Node] = deque(maxlen=2)
    for scan in scans:
        record = StepRecord(scan.index, scan.stamp)
        prepared = _prepare(scan, method.backend, record)
        descriptor = _describe(scan, method, record)
        record.t_guess_s = method.guess.observe(scan, prepared, method.backend)

        if not recent:
            edges: tuple[Edge, ...] = ()
            T_world_scan = chain.start(scan.index)
        else:
            selection = _select(scan, window, descriptor, method, record)
            edge = _register(scan, prepared, window, recent, selection, method, record)
            edges = (edge or _predict(scan, recent, method.guess),)
            T_world_scan = chain.add(edges[0])

        node = Node(scan.index, scan.stamp, T_world_scan, scan.odometry, prepared, descriptor)
        if prepared is not None and record.status != "skipped":
            window.push(node)
        recent.append(node)
        yield Step(record, edges, T_world_scan)


def _prepare(scan: Scan, backend: Backend, record: StepRecord) -> Prepared | None:
    """The prepared scan, or None (and why) if the backend cannot use it."""
    with _timed(record, "t_prepare_s", backend):
        try:
            return backend.prepare(scan)
        except BackendError as error:
            record.status, record.reason = "unusable", str(error)
            return None


def _describe(scan: Scan, method: Method, record: StepRecord) -> Descriptor | None:
    if not method.selector.needs_scores:
        return None
    with _timed(record, "t_describe_s", method.similarity):
        return method.similarity.describe(scan)


def _select(
    scan: Scan,
    window: Window,
    descriptor: Descriptor | None,
    method: Method,
    record: StepRecord,
) -> Selection:
    """The selector's ordered candidates for the scan."""
    if len(window) == 0:
        return Selection(())
    with _timed(record, "t_select_s", method.similarity):
        if descriptor is None:
            scores = np.full(len(window), np.nan)
        else:
            scores = method.similarity.scores(window.descriptors, descriptor)
        selection = method.selector.select(scan.index, window.scans, scores)
    record.candidates = sum(not c.is_fallback for c in selection.candidates)
    record.undefined_scores = selection.undefined
    return selection


def _register(
    scan: Scan,
    prepared: Prepared | None,
    window: Window,
    recent: Sequence[Node],
    selection: Selection,
    method: Method,
    record: StepRecord,
) -> Edge | None:
    """Try the candidates in order; the first registration that passes the check is the edge."""
    if prepared is None:
        return None
    record.status = "predicted" if selection.candidates else "skipped"
    if len(window) == 0:
        record.status, record.reason = "predicted", "no model scan yet"
    for candidate in selection.candidates:
        model = window.node(candidate.model)
        T_guess = method.guess.predict(model, scan, recent)
        try:
            with _timed(record, "t_prepare_s"):
                target = method.target.build(candidate.model, window, method.backend)
            record.registrations += 1
            started = time.perf_counter()
            result = method.backend.register(prepared, target, T_guess)
            if method.guess_along_degenerate is not None:
                record.kept_guess = unseen(result, method.guess_along_degenerate)
                result = remap(result, T_guess, method.guess_along_degenerate)
            why_not = method.check.reject(result, T_guess)
            spent = time.perf_counter() - started - (0.0 if result.reused else result.seconds)
            record.t_register_s += result.seconds
            record.t_check_s += max(0.0, spent)
        except BackendError as error:
            why_not = str(error)
        if why_not is None:
            _record(record, candidate, result)
            return Edge(candidate.model, scan.index, result.T_target_source, result.information)
        record.rejected += 1
        record.reason = why_not
    return None


def _predict(scan: Scan, recent: Sequence[Node], guess: Guess) -> Edge:
    """The motion since the previous scan as the guess has it: no measurement behind it."""
    T = guess.predict(recent[-1], scan, recent)
    return Edge(recent[-1].scan, scan.index, T, kind="predicted")


def _record(record: StepRecord, candidate: Candidate, result: RegistrationResult) -> None:
    record.status = "fallback" if candidate.is_fallback else "registered"
    record.reason = candidate.reason
    record.model, record.gap = candidate.model, record.scan - candidate.model
    record.score = candidate.score
    record.converged = result.converged
    record.fitness, record.inlier_rmse_m = result.fitness, result.inlier_rmse
    record.iterations, record.reused = result.iterations, result.reused
    record.library_fitness, record.library_rmse_m = result.library_fitness, result.library_rmse
    if result.information is not None:
        record.information = result.information.ravel().tolist()
    if result.localizability is not None:
        values, vectors = result.localizability.axes
        record.localizability_min = float(values[0])
        record.localizability = values.tolist()
        record.weak_direction = vectors[:, 0].tolist()


class _timed:  # noqa: N801 (reads as a word in a with statement)
    """Add the block's wall time to a stage of the record, and what a shared answer saved."""

    __slots__ = ("_plugin", "_record", "_stage", "_started")

    def __init__(
        self, record: StepRecord, stage: str, plugin: Backend | Similarity | None = None
    ) -> None:
        self._record, self._stage, self._plugin = record, stage, plugin

    def __enter__(self) -> None:
        if self._plugin is not None:
            self._plugin.saved_seconds = 0.0
        self._started = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        spent = time.perf_counter() - self._started
        if self._plugin is not None:
            spent += self._plugin.saved_seconds
        setattr(self._record, self._stage, getattr(self._record, self._stage) + spent)
