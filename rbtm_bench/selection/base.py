"""What a selector is: it orders the window's members; it never sees a backend."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.selection.window import Keyframes, Window
from rbtm_bench.types import Array

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


class Selector(ABC):
    """A strategy: which scans are remembered, and in which order they are tried.

    A plug-in writes ``order``. ``capacity`` is how many past scans the window holds;
    ``needs_scores`` whether the similarity has to be computed at all.
    """

    requires: tuple[str, ...] = ()
    needs_scores: bool = False

    def __init__(self, capacity: int, fallback: Fallback = "previous") -> None:
        self.capacity = capacity
        self.fallback = fallback

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

    def select(self, scan: int, models: NDArray[np.int64], scores: Array) -> Selection:
        """The ordered candidates, then the fallback (unless it was among them)."""
        tried = self.order(scan, models, scores)
        numbers, values = models.tolist(), scores.tolist()
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
