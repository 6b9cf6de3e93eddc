"""One registration of a scan to a candidate, judged and checked, and what follows a refusal."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import NamedTuple

from rbtm_bench.backends.base import Prepared
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array, Node, RegistrationResult
from rbtm_bench.odometry import checked
from rbtm_bench.odometry.degeneracy import fused, remap, unseen
from rbtm_bench.odometry.judge import MIN_INLIERS
from rbtm_bench.odometry.method import Ready, Work
from rbtm_bench.selection.base import Candidate, Trial
from rbtm_bench.selection.window import Window


class _Pair(NamedTuple):
    """A scan and what it is registered to, with the guess that the result is held against."""

    ready: Ready
    source: Prepared
    target: Prepared
    T_guess: Array
    has_motion: bool


def attempt(
    ready: Ready,
    source: Prepared,
    candidate: Candidate,
    past: Window,
    recent: Sequence[Node],
    work: Work,
) -> Trial | str:
    """The registration to one candidate, or why it is not believed."""
    method, record, model = work.method, ready.record, past.node(candidate.model)
    T_guess = work.predict(model, ready.scan, recent)
    started = time.perf_counter()
    try:
        target = checked.target(method.target, ready.scan, model.scan, past, method.backend)
    except BackendError as error:
        return str(error)
    record.t_prepare_s += time.perf_counter() - started
    pair = _Pair(ready, source, target, T_guess, method.guess.has_motion(recent))
    outcome, restart = _held(pair, T_guess, work), ""
    if isinstance(outcome, str):
        T_rest = inverse(model.T_world_scan) @ recent[-1].T_world_scan
        recovered = _recovered(pair, T_rest, work)
        if recovered is None:
            return outcome
        restart, outcome = recovered
    return Trial(candidate, model, outcome, len(target.key) or None, target.size, restart)


def _held(pair: _Pair, T_start: Array, work: Work) -> RegistrationResult | str:
    """The registration from one start, or why it is not believed."""
    method, record, T_guess = work.method, pair.ready.record, pair.T_guess
    record.registrations += 1
    started = time.perf_counter()
    try:
        result = work.register(pair.source, pair.target, T_start)
    except BackendError as error:
        return str(error)
    record.t_register_s += result.seconds
    if result.inliers < MIN_INLIERS:
        why_not: str | None = f"{result.inliers} inliers: expected at least {MIN_INLIERS}"
    else:
        if method.guess_along_degenerate is not None:
            record.kept_guess = unseen(result, method.guess_along_degenerate)
            result = remap(result, T_guess, method.guess_along_degenerate)
        if method.guess_weight is not None:
            result = fused(result, T_guess, method.guess_weight)
        why_not = checked.rejection(method.check, result, T_guess, pair.has_motion)
    spent = time.perf_counter() - started - (0.0 if result.reused else result.seconds)
    record.t_check_s += max(0.0, spent)
    return result if why_not is None else why_not


def _recovered(pair: _Pair, T_rest: Array, work: Work) -> tuple[str, RegistrationResult] | None:
    """The restart, and the registration from it, that is believed: of several the one of the
    highest fitness."""
    record = pair.ready.record
    started = time.perf_counter()
    try:
        starts = work.method.recovery.restarts(pair.source, pair.target, pair.T_guess, T_rest)
    except BackendError:
        return None
    record.t_register_s += time.perf_counter() - started
    best: tuple[str, RegistrationResult] | None = None
    for name, T_start in starts:
        outcome = _held(pair, checked.start(work.method.recovery, T_start), work)
        if isinstance(outcome, str):
            continue
        if best is None or outcome.fitness > best[1].fitness:
            best = (name, outcome)
    return best
