"""What is compared, and the work that the loop hands out (shared: ``pairs.shared``)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from rbtm_bench.backends.base import Backend, Prepared
from rbtm_bench.check.base import Check
from rbtm_bench.core.types import Array, Node, RegistrationResult, Scan, StepRecord
from rbtm_bench.core.uncertainty import InformationFrom
from rbtm_bench.guess.base import Guess
from rbtm_bench.odometry import checked, judge
from rbtm_bench.recovery.base import Recovery
from rbtm_bench.recovery.none import NoRecovery
from rbtm_bench.selection.base import Selector
from rbtm_bench.selection.window import Window
from rbtm_bench.similarity.band import Band
from rbtm_bench.similarity.base import Descriptor, PairwiseSimilarity, Similarity, checked_scores
from rbtm_bench.target.base import Target


class MotionFilter(NamedTuple):
    """m and deg since the last registered scan below which, both, a scan is not registered; 0:
    every scan is."""

    distance: float = 0.0
    angle_deg: float = 0.0


EVERY_SCAN = MotionFilter()


@dataclass(frozen=True)
class Method:
    """A backend, a way to choose the model scan, and what goes with them."""

    backend: Backend
    similarity: Similarity
    selector: Selector
    guess: Guess
    check: Check
    target: Target
    guess_along_degenerate: float | None = None
    """Keep the guess along directions of less localizability than this; None: never."""
    guess_weight: float | None = None
    """Share of the guess's information that counts beside the registration's; None: none."""
    motion_filter: MotionFilter = EVERY_SCAN
    """Scans that moved less, by the guess, are not registered."""
    recovery: Recovery = field(default_factory=NoRecovery)
    """What follows a registration that the check refuses."""
    judge_points: int = judge.MAX_POINTS
    """Points of a cloud in space that a registration is judged by, at most."""
    judge_radius: float | None = None
    """m within which it is judged; None: the backend's ``max_correspondence_distance``."""
    edges_from: InformationFrom | None = None
    """Where the covariance of edges comes from though no selector asks; None: nobody needs it."""

    @property
    def covariance_from(self) -> InformationFrom | None:
        """Where the covariance of edges comes from; None: nobody needs it."""
        return self.selector.covariance_from or self.edges_from


class Ready(NamedTuple):
    """A scan and what is known of it before it is registered."""

    scan: Scan
    record: StepRecord
    prepared: Prepared | None
    descriptor: Descriptor | None


def band_of(method: Method) -> Band | None:
    """Where the scores of scans with all those before them can be computed a block at a time."""
    selector, similarity = method.selector, method.similarity
    is_cheaper = isinstance(similarity, PairwiseSimilarity)  # others go pair by pair all the same
    if not selector.needs_scores or similarity.needs_guess or not is_cheaper:
        return None
    window = selector.window()
    return Band(similarity, window.capacity) if window.keyframes is None else None


class Work:
    """What the loop asks of a method's plug-ins. An answer comes with the seconds that it cost:
    those of its computation, which whoever shares answers hands on with them."""

    def __init__(self, method: Method) -> None:
        self.method = method
        judge.compile_kernels()  # never on a registration's time
        self._band, self._band_seconds = band_of(method), 0.0

    def prepare(self, scan: Scan) -> tuple[Prepared, float]:
        """The prepared scan. Raises ``BackendError`` for one that the backend cannot use."""
        started = time.perf_counter()
        prepared = checked.prepared(self.method.backend, scan)
        return prepared, time.perf_counter() - started

    def describe(self, scans: Sequence[Scan]) -> tuple[Descriptor, float]:
        """The descriptors (N, D) of a block of scans, in the loop's order; seconds are a scan's."""
        started = time.perf_counter()
        descriptors = checked.descriptors(self.method.similarity, scans)
        described = time.perf_counter()
        if self._band is not None and len(scans) > 1:
            self._band.extend(np.array([scan.index for scan in scans]), descriptors)
            self._band_seconds = (time.perf_counter() - described) / len(scans)
        return descriptors, (described - started) / len(scans)

    def scores(
        self, window: Window, scan: int, descriptor: Descriptor, motions: Array | None
    ) -> tuple[Array, float]:
        """Scores (W,) of the window's members for a described scan; with ``motions`` (W, 4, 4)
        under these guesses."""
        if self._band is not None:
            known = self._band.scores(window.scans, scan)
            if known is not None:
                return known, self._band_seconds
        started = time.perf_counter()
        similarity = self.method.similarity
        if motions is None:
            scores = similarity.scores(window.descriptors, descriptor)
        else:
            scores = similarity.scores_under(window.descriptors, descriptor, motions)
        seconds = time.perf_counter() - started
        return checked_scores(similarity, scores, (len(window),)), seconds

    def predict(self, model: Node, scan: Scan, recent: Sequence[Node]) -> Array:
        """The guess of T_model_scan (4, 4)."""
        guess = self.method.guess
        return checked.motion(guess, guess.predict(model, scan, recent))

    def register(
        self, source: Prepared, target: Prepared, T_target_source: Array
    ) -> RegistrationResult:
        """The judged registration of a pair. Raises ``BackendError`` if it cannot be done."""
        most, radius = self.method.judge_points, self.method.judge_radius
        return judge.register(self.method.backend, source, target, T_target_source, most, radius)
