"""What the loop lets through of a plug-in's answers, each looked at once, where it comes in.

Raises ``TypeError`` or ``ValueError`` that name the plug-in's class: it is wrong, so the run fails.
(A backend's poses: ``backends.base.checked_alignment``; a strategy's positions in the window:
``Selector.selection``.)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from rbtm_bench.backends.base import Backend, Prepared
from rbtm_bench.check.base import Check
from rbtm_bench.core.errors import one_line
from rbtm_bench.core.geometry import is_rigid
from rbtm_bench.core.types import Array, RegistrationResult, Scan
from rbtm_bench.guess.base import Guess
from rbtm_bench.recovery.base import Recovery
from rbtm_bench.selection.base import Candidate, Selection, Selector, Trial
from rbtm_bench.selection.window import Window
from rbtm_bench.similarity.base import Descriptor, Similarity
from rbtm_bench.target.base import Target


@cache
def _is_ours(kind: type) -> bool:
    """Whether a plug-in comes with the package: the contract tests hold it to what is asked here,
    and so often."""
    return kind.__module__.startswith("rbtm_bench.")


def prepared(backend: Backend, scan: Scan) -> Prepared:
    """The backend's prepared scan: of this scan and no other."""
    given: Any = backend.prepare(scan)
    plugin: Backend = getattr(backend, "wrapped", backend)  # behind a search
    if _is_ours(type(plugin)):
        return given
    _require_prepared(given, f"{type(backend).__name__}.prepare")
    if given.key not in ((), ((scan.index, None),)):
        name = type(backend).__name__
        raise ValueError(f"{name}.prepare returned scans {_scans(given)} for scan {scan.index}")
    return given


def descriptor(similarity: Similarity, scan: Scan) -> Descriptor:
    """The scan's descriptor (D,), an array of our own: a plug-in may fill one array again."""
    given = np.array(similarity.describe(scan))
    if given.ndim != 1 or given.dtype.kind not in "biufc":
        what = f"{given.dtype.name} of shape {given.shape}"
        raise ValueError(f"{type(similarity).__name__}.describe returned {what}: expected (D,)")
    return given


def descriptors(similarity: Similarity, scans: Sequence[Scan]) -> Descriptor:
    """The descriptors (N, D) of scans."""
    if _is_ours(type(similarity)):
        return similarity.describe_all(scans)
    return np.stack([descriptor(similarity, scan) for scan in scans])


def motion(guess: Guess, given: Any) -> Array:
    """A guess (4, 4), a copy: a plug-in may fill one array again."""
    return given if _is_ours(type(guess)) else _rigid(given, f"{type(guess).__name__}.predict")


def start(recovery: Recovery, given: Any) -> Array:
    """Where a restart begins (4, 4), a copy."""
    if _is_ours(type(recovery)):
        return given
    return _rigid(given, f"{type(recovery).__name__}.restarts")


def _rigid(given: Any, name: str) -> Array:
    """A copy in float64 of the motion (4, 4) that ``name`` returned."""
    T = np.array(given)
    if T.dtype.kind not in "fiu" or not is_rigid(T, tolerance=1e-5):
        what = f"{T.dtype.name} of shape {T.shape}"
        raise ValueError(f"{name} returned {what}, no rigid motion (4, 4)")
    return T.astype(np.float64, copy=False)


def seconds(guess: Guess, given: Any) -> float:
    """What ``observe`` says that it took."""
    if _is_ours(type(guess)):
        return given
    if isinstance(given, bool | complex | str) or not 0.0 <= (value := float(given)) < math.inf:
        raise ValueError(f"{type(guess).__name__}.observe returned {one_line(given)}: expected s")
    return value


def selection(selector: Selector, window: Window, given: Any, scan: int) -> Selection:
    """What ``choose`` answers for a scan: candidates of the window, each once."""
    if _is_ours(type(selector)):
        return given
    name = type(selector).__name__
    if not isinstance(given, Selection):
        raise TypeError(f"{name}.choose returned {type(given).__name__}: expected a Selection")
    members = set(window.scans.tolist())
    tried: set[int] = set()
    for candidate in given.candidates:
        model = candidate.model if isinstance(candidate, Candidate) else None
        if not _is_whole(model) or model not in members - tried or model >= scan:
            raise ValueError(f"{name} chose {one_line(candidate)}: expected members, each once")
        if not isinstance(candidate.reason, str):
            raise TypeError(f"{name} gives {one_line(candidate.reason)} as a reason")
        tried.add(model)
    return given


def pick(selector: Selector, scan: Scan, trials: Sequence[Trial]) -> tuple[int, str]:
    """Which of the accepted registrations the strategy believes, and why."""
    which, reason = selector.pick(scan, trials)
    if not _is_whole(which) or not 0 <= which < len(trials) or not isinstance(reason, str):
        name = type(selector).__name__
        raise ValueError(f"{name}.pick chose {which!r} of {len(trials)} registrations")
    return int(which), reason


def target(plugin: Target, scan: Scan, model: int, window: Window, backend: Backend) -> Prepared:
    """What the scan is registered to: made of earlier scans."""
    given: Any = plugin.build(model, window, backend)
    if _is_ours(type(plugin)):
        return given
    name = f"{type(plugin).__name__}.build"
    _require_prepared(given, name)
    if any(number >= scan.index for number in _scans(given)):
        raise ValueError(f"{name}: of scans {_scans(given)}, not all earlier than {scan.index}")
    return given


def rejection(
    check: Check, result: RegistrationResult, T_guess: Array, has_motion: bool = True
) -> str | None:
    """Why the check does not believe a registration; None if it does."""
    ask = check.reject if has_motion else check.reject_first
    given: Any = ask(result, T_guess)
    if _is_ours(type(check)):
        return given
    if given is not None and not isinstance(given, str):
        name = type(check).__name__
        raise TypeError(f"{name}.reject returned {type(given).__name__}: expected None or a reason")
    return None if given is None else one_line(given)


def _require_prepared(given: Any, name: str) -> None:
    if not isinstance(given, Prepared):
        raise TypeError(f"{name} returned {type(given).__name__}: expected a Prepared")
    points: Any = given.points
    if not isinstance(points, np.ndarray) or points.dtype != np.float64:
        raise TypeError(f"{name}: points are {type(points).__name__}: expected float64 (N, 3)")
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(f"{name}: points {points.shape}: expected finite ones, (N, 3)")


def _is_whole(value: Any) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def _scans(given: Prepared) -> list[int]:
    return [number for number, _ in given.key]
