"""The loop: describe, select, register, check, update, record. It knows no files."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from rbtm_bench.backends.base import Prepared
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.trajectory import PoseChain
from rbtm_bench.core.types import Array, Edge, Node, RegistrationResult, Scan, Step, StepRecord
from rbtm_bench.core.uncertainty import chained, edge_covariance
from rbtm_bench.odometry import checked
from rbtm_bench.odometry.degeneracy import remap, unseen
from rbtm_bench.odometry.method import Method, Work
from rbtm_bench.selection.base import Selection, Selector, Trial
from rbtm_bench.selection.window import Window
from rbtm_bench.similarity.base import Descriptor


def odometry(scans: Iterable[Scan], method: Method, work: Work | None = None) -> Iterator[Step]:
    """Register a stream of scans, one at a time, and yield what became of each.

    The first scan is the origin. Memory is bounded by the selector's window (and the poses).
    A scan for which no registration is accepted keeps its predicted pose and says so. Ground truth
    is taken off the scans before anything sees them, but for a selector that says it needs it.
    ``work`` does what the plug-ins are asked for; None: by them alone, every time.
    """
    work = work or Work(method)
    window = method.selector.window()
    chain = PoseChain()
    recent: deque[Node] = deque(maxlen=2)
    left_out = 0  # scans in a row that matched nothing and are no model scans
    for scan in scans:
        if method.selector.needs_truth:
            method.selector.see(scan)
        scan = scan.without_truth()
        record = StepRecord(scan.index, scan.stamp)
        prepared = _prepare(scan, work, record)
        descriptor = None
        if method.selector.needs_scores:
            descriptor, record.t_describe_s = work.describe(scan)
        observed = method.guess.observe(scan, prepared, work.register)
        record.t_guess_s = checked.seconds(method.guess, observed)

        if not recent:
            edges: tuple[Edge, ...] = ()
            T_world_scan = chain.start(scan.index)
            lost = False
        else:
            selection = _select(scan, window, recent, descriptor, work, record)
            edge = _register(scan, prepared, window, recent, selection, work, record)
            if edge is None and left_out >= method.selector.patience:
                edge = _restart(scan, prepared, window, recent, descriptor, work, record)
            edges = (edge or _predict(scan, recent, work),)
            T_world_scan = chain.add(edges[0])
            lost = edge is None and _is_left_out(record, window, method.selector)

        hops, covariance = _behind(edges, window, recent, method.selector)
        node = Node(
            scan.index,
            scan.stamp,
            T_world_scan,
            scan.odometry,
            prepared,
            descriptor,
            hops,
            covariance,
        )
        left_out = left_out + 1 if lost else 0
        if prepared is not None and not lost:
            window.push(node)
        recent.append(node)
        yield Step(record, edges, T_world_scan)


def _prepare(scan: Scan, work: Work, record: StepRecord) -> Prepared | None:
    """The prepared scan, or None (and why) if the backend cannot use it."""
    try:
        prepared, record.t_prepare_s = work.prepare(scan)
    except BackendError as error:
        record.status, record.reason = "unusable", str(error)
        return None
    return prepared


def _select(
    scan: Scan,
    window: Window,
    recent: Sequence[Node],
    descriptor: Descriptor | None,
    work: Work,
    record: StepRecord,
) -> Selection:
    """The selector's ordered candidates for the scan."""
    if len(window) == 0:
        return Selection(())
    scores = np.full(len(window), np.nan)
    motions: Array | None = None
    if descriptor is not None and work.method.similarity.needs_guess:
        with _timed(record, "t_guess_s"):
            motions = np.stack([work.predict(n, scan, recent) for n in window.nodes])
    if descriptor is not None:
        scores, seconds = work.scores(window.descriptors, descriptor, motions)
        record.t_select_s += seconds
    with _timed(record, "t_select_s"):
        given = work.method.selector.choose(scan.index, window, scores)
        selection = checked.selection(work.method.selector, window, given, scan.index)
    record.candidates += sum(not c.is_fallback for c in selection.candidates)
    record.undefined_scores += selection.undefined
    return selection


def _register(
    scan: Scan,
    prepared: Prepared | None,
    window: Window,
    recent: Sequence[Node],
    selection: Selection,
    work: Work,
    record: StepRecord,
) -> Edge | None:
    """Try the candidates in order; the first registration that passes the check is the edge, or,
    for a selector that tries all, the one that it picks of those."""
    if prepared is None:
        return None
    method = work.method
    record.status = "predicted" if selection.candidates else "skipped"
    if len(window) == 0:
        record.status, record.reason = "predicted", "no model scan yet"
    accepted: list[Trial] = []
    for candidate in selection.candidates:
        model = window.node(candidate.model)
        outcome = _attempt(scan, prepared, model, window, recent, work, record)
        if isinstance(outcome, RegistrationResult):
            accepted.append(Trial(candidate, model, outcome))
            if not method.selector.tries_all:
                break
        else:
            record.rejected += 1
            record.reason = outcome
    if not accepted:
        return None
    with _timed(record, "t_select_s"):
        which, reason = checked.pick(method.selector, scan, accepted)
    chosen = accepted[which]
    _record(record, chosen, reason, method.guess_along_degenerate)
    return _edge(chosen.model, scan, chosen.result, method.selector)


def _attempt(
    scan: Scan,
    prepared: Prepared,
    model: Node,
    window: Window,
    recent: Sequence[Node],
    work: Work,
    record: StepRecord,
) -> RegistrationResult | str:
    """The registration to one candidate, or why it is not believed."""
    method = work.method
    T_guess = work.predict(model, scan, recent)
    try:
        with _timed(record, "t_prepare_s"):
            target = checked.target(method.target, scan, model.scan, window, method.backend)
        record.registrations += 1
        started = time.perf_counter()
        result = work.register(prepared, target, T_guess)
        if method.guess_along_degenerate is not None:
            record.kept_guess = unseen(result, method.guess_along_degenerate)
            result = remap(result, T_guess, method.guess_along_degenerate)
        why_not = checked.rejection(method.check, result, T_guess)
        spent = time.perf_counter() - started - (0.0 if result.reused else result.seconds)
        record.t_register_s += result.seconds
        record.t_check_s += max(0.0, spent)
    except BackendError as error:
        return str(error)
    return result if why_not is None else why_not


def _restart(
    scan: Scan,
    prepared: Prepared | None,
    window: Window,
    recent: Sequence[Node],
    descriptor: Descriptor | None,
    work: Work,
    record: StepRecord,
) -> Edge | None:
    """Try the scan before, alone, although it matched nothing itself.

    Without this a window that nothing enters would grow old for ever. That two scans in a row
    match is what tells a place that the window does not know from noise.
    """
    last = recent[-1]
    if prepared is None or last.prepared is None:
        return None
    alone = Window(1)
    alone.push(last)
    selection = _select(scan, alone, recent, descriptor, work, record)
    if not selection.candidates:
        return None
    edge = _register(scan, prepared, alone, recent, selection, work, record)
    if edge is not None:
        window.push(last, always=True)
        record.restart, record.reason = True, f"restart: {record.reason}"
    return edge


def _is_left_out(record: StepRecord, window: Window, selector: Selector) -> bool:
    """Whether a scan that no registration was accepted for is kept out of the window."""
    if len(window) == 0:
        return False
    return record.status == "skipped" or selector.fallback == "skip"


def _predict(scan: Scan, recent: Sequence[Node], work: Work) -> Edge:
    """The motion since the previous scan as the guess has it: no measurement behind it."""
    T = work.predict(recent[-1], scan, recent)
    covariance = None
    if work.method.selector.covariance_from is not None:
        covariance = edge_covariance(None, scan.planar)
    return Edge(recent[-1].scan, scan.index, T, kind="predicted", covariance=covariance)


def _edge(model: Node, scan: Scan, result: RegistrationResult, selector: Selector) -> Edge:
    """The measured motion between two scans."""
    covariance = None
    if selector.covariance_from is not None:
        covariance = edge_covariance(result, scan.planar, selector.covariance_from)
    T, information = result.T_target_source, result.information
    return Edge(model.scan, scan.index, T, information, covariance=covariance)


def _behind(
    edges: Sequence[Edge], window: Window, recent: Sequence[Node], selector: Selector
) -> tuple[int, Array | None]:
    """Hops and covariance of the chain from the start to a scan with these edges."""
    if not edges:
        return 0, None if selector.covariance_from is None else np.zeros((6, 6))
    edge = edges[0]
    model = recent[-1] if edge.model == recent[-1].scan else window.node(edge.model)
    if edge.covariance is None or model.covariance is None:
        return model.hops + 1, None
    return model.hops + 1, chained(model.covariance, edge.T_model_scan, edge.covariance)


def _record(record: StepRecord, chosen: Trial, reason: str, threshold: float | None) -> None:
    candidate, result = chosen.candidate, chosen.result
    record.status = "fallback" if candidate.is_fallback else "registered"
    record.reason = reason
    record.model, record.gap = candidate.model, record.scan - candidate.model
    record.score = candidate.score
    record.converged = result.converged
    record.fitness, record.inlier_rmse_m = result.fitness, result.inlier_rmse
    record.iterations, record.reused = result.iterations, result.reused
    record.library_fitness, record.library_rmse_m = result.library_fitness, result.library_rmse
    if threshold is not None:
        record.kept_guess = unseen(result, threshold)
    if result.information is not None:
        record.information = result.information.ravel().tolist()
    if result.localizability is not None:
        values, vectors = result.localizability.axes
        record.localizability_min = float(values[0])
        record.localizability = values.tolist()
        record.weak_direction = vectors[:, 0].tolist()


class _timed:  # noqa: N801 (reads as a word in a with statement)
    """Add the block's wall time to a stage of the record."""

    __slots__ = ("_record", "_stage", "_started")

    def __init__(self, record: StepRecord, stage: str) -> None:
        self._record, self._stage = record, stage

    def __enter__(self) -> None:
        self._started = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        spent = time.perf_counter() - self._started
        setattr(self._record, self._stage, getattr(self._record, self._stage) + spent)
