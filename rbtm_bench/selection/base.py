"""What a selector is: it orders the window's members; it never sees a backend."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.types import Array, Node, RegistrationResult, Scan
from rbtm_bench.core.uncertainty import InformationFrom
from rbtm_bench.selection.window import Keyframes, Window

Fallback = Literal["previous", "best", "skip"]
Content = Literal["scans", "keyframes"]


class Candidate(NamedTuple):
    """A scan to try as the model scan, and why."""

    model: int
    score: float
    reason: str
    is_fallback: bool = False


@dataclass(frozen=True)
class Selection:
    """Candidates in the order in which they are to be tried; an empty list means "skip"."""

    candidates: tuple[Candidate, ...]
    undefined: int = 0
    """How many of the window's scores were undefined (NaN)."""


class Trial(NamedTuple):
    """A candidate whose registration was accepted."""

    candidate: Candidate
    model: Node
    result: RegistrationResult


class Selector(ABC):
    """A strategy: which scans are remembered, and in which order they are tried.

    A plug-in writes ``order``. ``capacity`` is how many past scans the window holds;
    ``needs_scores`` whether the similarity has to be computed at all. With ``fallback`` "skip" a
    scan without an accepted registration is no model scan for others; after ``restart_after`` of
    them in a row (None: ``capacity`` + 1) the one before may be, if the new scan matches it.
    """

    requires: tuple[str, ...] = ()
    needs_scores: bool = False
    needs_truth: bool = False
    """True for what is no method but a bound: ``see`` is then given every scan with its ground
    truth, which nothing else in the loop ever sees. Its results must say so in their reason."""
    needs_check: bool = False
    """True: refused together with a check that accepts everything."""
    tries_all: bool = False
    """True: every candidate is registered, and ``pick`` chooses among those that are accepted."""
    covariance_from: InformationFrom | None = None
    """Where the covariance of the window's nodes comes from; None: nobody needs it."""
    restart_after: int | None = None

    def __init__(
        self, capacity: int, fallback: Fallback = "previous", restart_after: int | None = None
    ) -> None:
        self.capacity = capacity
        self.fallback = fallback
        self.restart_after = restart_after

    @property
    def patience(self) -> int:
        """Scans in a row that may match nothing. By default as many as the window counts, the new
        one included: from then on it remembers only what it would have forgotten."""
        return self.capacity + 1 if self.restart_after is None else max(1, self.restart_after)

    def window(self) -> Window:
        """A new, empty window of the kind that this strategy needs."""
        return Window(self.capacity)

    @abstractmethod
    def order(self, scan: int, models: NDArray[np.int64], scores: Array) -> list[tuple[int, str]]:
        """Positions in the window to try, best first, each with a reason.

        ``scan`` is the new scan's number, ``models`` (W,) the numbers of the window's members,
        oldest first, ``scores`` (W,) their similarity to the new scan (NaN: undefined, or all
        NaN if ``needs_scores`` is False). W >= 1.
        """

    def see(self, scan: Scan) -> None:  # noqa: B027 (only with needs_truth)
        """Every scan with its ground truth, before it is selected for; see ``needs_truth``."""

    def choose(self, scan: int, window: Window, scores: Array) -> Selection:
        """What the loop calls: ``select`` with the window's numbers. A strategy that looks at the
        members themselves derives from ``thresholded.ChainSelector``."""
        return self.select(scan, window.scans, scores)

    def select(self, scan: int, models: NDArray[np.int64], scores: Array) -> Selection:
        """The ordered candidates, then the fallback (unless it was among them)."""
        return self.selection(self.order(scan, models, scores), models, scores)

    def pick(self, scan: Scan, trials: Sequence[Trial]) -> tuple[int, str]:
        """Which of the accepted registrations is believed, and why: the first, and the
        only one unless ``tries_all``; ``scan`` has no ground truth."""
        return 0, trials[0].candidate.reason

    def selection(
        self, tried: list[tuple[int, str]], models: NDArray[np.int64], scores: Array
    ) -> Selection:
        """Candidates out of positions with reasons, and the fallback."""
        numbers, values = models.tolist(), scores.tolist()
        for i, _ in tried:
            if (
                isinstance(i, bool)
                or not isinstance(i, int | np.integer)
                or not 0 <= i < len(numbers)
            ):
                name = type(self).__name__
                raise ValueError(f"{name} chose position {i!r} in a window of {len(numbers)}")
        if len({i for i, _ in tried}) < len(tried):
            raise ValueError(f"{type(self).__name__} chose a position twice of {len(numbers)}")
        chosen = [Candidate(numbers[i], values[i], why) for i, why in tried]
        last = self._fallback(scores)
        if last is not None and last not in [i for i, _ in tried]:
            why = f"fallback {self.fallback}"
            chosen.append(Candidate(numbers[last], values[last], why, True))
        undefined = int(np.isnan(scores).sum()) if self.needs_scores else 0
        return Selection(tuple(chosen), undefined)

    def _fallback(self, scores: Array) -> int | None:
        newest = len(scores) - 1
        if self.fallback == "skip":
            return None
        if self.fallback == "previous" or np.isnan(scores).all():
            return newest
        return int(np.nanargmax(scores))


def keyframes_or_scans(content: Content, distance: float, angle_deg: float) -> Keyframes | None:
    """The window's rule for ``content``: None keeps every scan."""
    return Keyframes(distance, angle_deg) if content == "keyframes" else None
