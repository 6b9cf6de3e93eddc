"""What is compared, and the work that the loop hands out (shared: ``pairs.shared``)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from rbtm_bench.backends.base import Backend, Prepared
from rbtm_bench.check.base import Check
from rbtm_bench.core.types import Array, Node, RegistrationResult, Scan
from rbtm_bench.guess.base import Guess
from rbtm_bench.odometry import checked, judge
from rbtm_bench.selection.base import Selector
from rbtm_bench.similarity.base import Descriptor, Similarity, checked_scores
from rbtm_bench.target.base import Target


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


class Work:
    """What the loop asks of a method's plug-ins. An answer comes with the seconds that it cost:
    those of its computation, which whoever shares answers hands on with them."""

    def __init__(self, method: Method) -> None:
        self.method = method
        judge.compile_kernels()  # never on a registration's time

    def prepare(self, scan: Scan) -> tuple[Prepared, float]:
        """The prepared scan. Raises ``BackendError`` for one that the backend cannot use."""
        started = time.perf_counter()
        prepared = checked.prepared(self.method.backend, scan)
        return prepared, time.perf_counter() - started

    def describe(self, scan: Scan) -> tuple[Descriptor, float]:
        """The descriptor (D,) of a scan."""
        started = time.perf_counter()
        descriptor = checked.descriptor(self.method.similarity, scan)
        return descriptor, time.perf_counter() - started

    def scores(
        self, window: Descriptor, descriptor: Descriptor, motions: Array | None
    ) -> tuple[Array, float]:
        """Scores (W,) of the window's descriptors against one; with ``motions`` (W, 4, 4) under
        these guesses."""
        started = time.perf_counter()
        similarity = self.method.similarity
        if motions is None:
            scores = similarity.scores(window, descriptor)
        else:
            scores = similarity.scores_under(window, descriptor, motions)
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
        return judge.register(self.method.backend, source, target, T_target_source)
