"""The loop: describe, select, register, check, update, record. It knows no files.

What does not need the loop's outcome is done for a block of scans before it (descriptors, scores of
all scans with those before them), what it does not need itself after it (``rows``).
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array, Edge, Node, RegistrationResult, Scan, Step, StepRecord
from rbtm_bench.core.uncertainty import chained, edge_covariance, inflated, odometry_covariance
from rbtm_bench.odometry import checked, rows
from rbtm_bench.odometry.attempt import attempt
from rbtm_bench.odometry.chain import PoseChain
from rbtm_bench.odometry.method import Method, Ready, Work
from rbtm_bench.odometry.motion_filter import is_still
from rbtm_bench.selection.base import Selection, Selector, Trial
from rbtm_bench.selection.window import Window

MOST_POINTS = 1_000_000
"""A block ends with the scan that makes it so many points: 24 MB."""
PATIENCE = 0.5
"""s after which finished scans are handed out, though their block goes on."""
DISAGREEMENT = 5.0
"""Of several edges: the squared sigmas beyond which one that disagrees counts less (DCS)."""
UNKNOWN = np.full(1024, np.nan)
"""Scores that nobody asked for."""


def odometry(
    scans: Iterable[Scan], method: Method, work: Work | None = None, block: int = 1
) -> Iterator[Step]:
    """Register a stream of scans, one at a time, and yield what became of each.

    The first scan is the origin. Memory is bounded by the selector's window, the block and the
    poses. A scan for which no registration is accepted keeps its predicted pose and says so.
    Ground truth is taken off the scans before anything sees them, but for a selector that says it
    needs it. ``work`` does what the plug-ins are asked for; None: by them alone, every time.
    ``block`` scans are read ahead, which changes nothing but the time; 1 for a live stream.
    """
    work = work or Work(method)
    window = method.selector.window()
    past = method.target.window(window)  # the same, or what the target needs beside it
    chain = PoseChain()
    recent: deque[Node] = deque(maxlen=2)
    moving: Node | None = None  # the last scan that was not still
    left_out = 0  # scans in a row that matched nothing and are no model scans
    for part in _blocks(scans, block):
        done: list[Step] = []
        since = time.perf_counter()
        for ready in _ready(part, work):
            edges: tuple[Edge, ...] = ()
            still = is_still(ready, recent, moving, work)
            if still:
                ready.record.status, ready.record.reason = "still", "moved too little"
            elif recent:
                selection = _select(ready, window, recent, work)
                ready.record.pick = rows.first_pick(window, selection, method.selector)
                edges = _register(ready, window, past, recent, selection, work)
                if not edges and left_out >= method.selector.patience:
                    edges = _restart(ready, window, past, recent, work)
            node, step, lost = _place(ready, edges, window, recent, chain, work)
            left_out = left_out if still else left_out + 1 if lost else 0
            moving = moving if still else node
            if node.prepared is not None and not lost and not still:
                _remember(node, window, past)
            recent.append(node)
            done.append(step)
            if time.perf_counter() - since > PATIENCE:
                yield from rows.finished(done)
                done, since = [], time.perf_counter()
        yield from rows.finished(done)


def _remember(node: Node, window: Window, past: Window, always: bool = False) -> None:
    """Push a scan into the selector's window and into the target's, if that is another."""
    window.push(node, always)
    if past is not window:
        past.push(node, always)


def _blocks(scans: Iterable[Scan], most: int) -> Iterator[list[Scan]]:
    """The scans in blocks of at most ``most``, and of about ``MOST_POINTS`` points."""
    part: list[Scan] = []
    points = 0
    for scan in scans:
        part.append(scan)
        points += len(scan.points)
        if len(part) >= most or points >= MOST_POINTS:
            yield part
            part, points = [], 0
    if part:
        yield part


def _ready(part: Sequence[Scan], work: Work) -> Iterator[Ready]:
    """Describe a block, and prepare one scan after the other."""
    method = work.method
    if method.selector.needs_truth:
        for scan in part:
            method.selector.see(scan)
    part = [scan.without_truth() for scan in part]
    if method.selector.needs_scans:
        for scan in part:
            method.selector.see(scan)
    descriptors, seconds = None, 0.0
    if method.selector.needs_scores:
        descriptors, seconds = work.describe(part)
    for i, scan in enumerate(part):
        record = StepRecord(scan.index, scan.stamp)
        record.t_describe_s = seconds
        prepared = None
        try:
            prepared, record.t_prepare_s = work.prepare(scan)
        except BackendError as error:
            record.status, record.reason = "unusable", str(error)
        observed = method.guess.observe(scan, prepared, work.register)
        record.t_guess_s = checked.seconds(method.guess, observed)
        yield Ready(scan, record, prepared, None if descriptors is None else descriptors[i])


def _select(ready: Ready, window: Window, recent: Sequence[Node], work: Work) -> Selection:
    """The selector's ordered candidates for the scan."""
    if len(window) == 0:
        return Selection(())
    scan, record, method = ready.scan, ready.record, work.method
    seconds = 0.0
    if ready.descriptor is None:
        scores = (
            UNKNOWN[: len(window)] if len(window) <= len(UNKNOWN) else np.full(len(window), np.nan)
        )
    else:
        motions: Array | None = None
        if method.similarity.needs_guess:
            started = time.perf_counter()
            motions = np.stack([work.predict(n, scan, recent) for n in window.nodes])
            record.t_guess_s += time.perf_counter() - started
        scores, seconds = work.scores(window, scan.index, ready.descriptor, motions)
    started = time.perf_counter()
    given = method.selector.choose(scan.index, window, scores)
    selection = checked.selection(method.selector, window, given, scan.index)
    record.candidates += selection.chosen
    record.undefined_scores += selection.undefined
    record.t_select_s += seconds + time.perf_counter() - started
    return selection


def _register(
    ready: Ready,
    window: Window,
    past: Window,
    recent: Sequence[Node],
    selection: Selection,
    work: Work,
) -> tuple[Edge, ...]:
    """Try the candidates in order; the first registrations that pass the check are the edges, as
    many as the selector asks for, or, for one that tries all, the one that it picks of those."""
    scan, record, selector = ready.scan, ready.record, work.method.selector
    if ready.prepared is None:
        return ()
    record.status = "predicted" if selection.candidates else "skipped"
    if len(window) == 0:
        record.status, record.reason = "predicted", "no model scan yet"
    accepted: list[Trial] = []
    refused = [record.refused] if record.refused else []  # before a restart
    for candidate in selection.candidates:
        outcome = attempt(ready, ready.prepared, candidate, past, recent, work)
        if isinstance(outcome, Trial):
            accepted.append(outcome)
            if not selector.tries_all and len(accepted) >= selector.edges:
                break
        else:
            record.rejected += 1
            record.reason = outcome
            refused.append(f"{candidate.model}: {' '.join(outcome.split())}")
    record.refused = "\n".join(refused)
    if not accepted:
        return ()
    started = time.perf_counter()
    which, reason = checked.pick(selector, scan, accepted)
    record.t_select_s += time.perf_counter() - started
    chosen = accepted[which]
    rows.fill(record, chosen, reason, work.method.guess_along_degenerate)
    work.method.check.accept(chosen.result)
    kept = accepted if selector.edges > 1 else [chosen]
    return tuple(_edge(one.model, scan, one.result, work.method) for one in kept)


def _restart(
    ready: Ready, window: Window, past: Window, recent: Sequence[Node], work: Work
) -> tuple[Edge, ...]:
    """Try the scan before, alone, although it matched nothing itself.

    Without this a window that nothing enters would grow old for ever. That two scans in a row
    match is what tells a place that the window does not know from noise.
    """
    last, record = recent[-1], ready.record
    if ready.prepared is None or last.prepared is None:
        return ()
    alone = Window(1)
    known = work.method.target.window(alone)
    _remember(last, alone, known)
    selection = _select(ready, alone, recent, work)
    if not selection.candidates:
        return ()
    edges = _register(ready, alone, known, recent, selection, work)
    if edges:
        _remember(last, window, past, always=True)
        record.restart, record.reason = True, f"restart: {record.reason}"
    return edges


def _place(
    ready: Ready,
    edges: tuple[Edge, ...],
    window: Window,
    recent: Sequence[Node],
    chain: PoseChain,
    work: Work,
) -> tuple[Node, Step, bool]:
    """The scan with its pose, and whether it is kept out of the window: by the accepted edges, else
    by the guess."""
    scan, record, selector = ready.scan, ready.record, work.method.selector
    link, lost = None, False
    if not recent:
        T_world_scan = chain.start(scan.index)
    else:
        lost = not edges and _is_left_out(record, window, selector)
        edges = edges or (_predict(scan, recent, work),)
        link = _joined(edges, chain, scan.planar)
        T_world_scan = chain.add(link)
    hops, covariance = _behind(link, window, recent, selector)
    node = Node(
        scan.index,
        scan.stamp,
        T_world_scan,
        scan.odometry,
        ready.prepared,
        ready.descriptor,
        hops,
        covariance,
    )
    return node, Step(record, edges, T_world_scan), lost


def _is_left_out(record: StepRecord, window: Window, selector: Selector) -> bool:
    """Whether a scan that no registration was accepted for is kept out of the window."""
    if len(window) == 0:
        return False
    return record.status == "skipped" or selector.fallback == "skip"


def _predict(scan: Scan, recent: Sequence[Node], work: Work) -> Edge:
    """The motion since the previous scan as the guess has it: no measurement behind it."""
    T = work.predict(recent[-1], scan, recent)
    covariance = None
    if work.method.covariance_from is not None:
        by_odometry = work.method.guess.needs_odometry
        covariance = (
            odometry_covariance(T, scan.planar)
            if by_odometry
            else edge_covariance(None, scan.planar)
        )
    return Edge(recent[-1].scan, scan.index, T, kind="predicted", covariance=covariance)


def _edge(model: Node, scan: Scan, result: RegistrationResult, method: Method) -> Edge:
    """The measured motion between two scans."""
    covariance = None
    if method.covariance_from is not None:
        covariance = edge_covariance(result, scan.planar, method.covariance_from)
    T, information = result.T_target_source, result.information
    return Edge(model.scan, scan.index, T, information, covariance=covariance)


def _joined(edges: Sequence[Edge], chain: PoseChain, planar: bool) -> Edge:
    """The edge that a scan hangs on: its only one, or the first with the motion that agrees best
    with all, the model scans held at their poses."""
    if len(edges) == 1:
        return edges[0]
    from rbtm_bench.graph.fused import fused  # brings scipy, which most runs do without

    T_first_world = inverse(chain.pose(edges[0].model))
    motions = np.stack([T_first_world @ chain.pose(e.model) @ e.T_model_scan for e in edges])
    covariances = np.stack(
        [inflated(e.covariance, e.T_model_scan, planar) for e in edges if e.covariance is not None]
    )
    T, covariance = fused(motions, covariances, planar, DISAGREEMENT)
    return replace(edges[0], T_model_scan=T, information=None, covariance=covariance)


def _behind(
    edge: Edge | None, window: Window, recent: Sequence[Node], selector: Selector
) -> tuple[int, Array | None]:
    """Hops and covariance of the chain from the start to a scan that hangs on this edge."""
    if edge is None:
        return 0, None if selector.covariance_from is None else np.zeros((6, 6))
    model = recent[-1] if edge.model == recent[-1].scan else window.node(edge.model)
    if edge.covariance is None or model.covariance is None:
        return model.hops + 1, None
    return model.hops + 1, chained(model.covariance, edge.T_model_scan, edge.covariance)
