"""What a selector is: it orders the window's members; it never sees a backend."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.errors import ConfigError
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


class Candidates(Sequence[Candidate]):
    """Candidates made when they are looked at: of hundreds that pass, one or two are tried."""

    def __init__(
        self,
        tried: Sequence[tuple[int, str]],
        models: NDArray[np.int64],
        scores: Array,
        fallback: tuple[int, str] | None,
        owner: str,
    ) -> None:
        """``tried`` and ``fallback`` are positions in the window with reasons; ``owner`` is the
        selector's name."""
        self._tried, self._models, self._scores = tried, models, scores
        self._fallback, self._owner = fallback, owner

    def __len__(self) -> int:
        return len(self._tried) + (self._last() is not None)

    def __bool__(self) -> bool:
        return bool(self._tried) or self._fallback is not None

    def __iter__(self) -> Iterator[Candidate]:
        for position, reason in self._tried:
            yield self._candidate(position, reason)
        last = self._last()
        if last is not None:
            yield self._candidate(*last, is_fallback=True)

    @overload
    def __getitem__(self, index: int) -> Candidate: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Candidate, ...]: ...
    def __getitem__(self, index: int | slice) -> Candidate | tuple[Candidate, ...]:
        return tuple(self)[index]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and tuple(self) == tuple(other)

    def __hash__(self) -> int:
        return hash(tuple(self))

    def _last(self) -> tuple[int, str] | None:
        """The fallback, unless it has been tried by then."""
        last = self._fallback
        if last is None or any(position == last[0] for position, _ in self._tried):
            return None
        return last

    def _candidate(self, position: int, reason: str, is_fallback: bool = False) -> Candidate:
        is_number = isinstance(position, int | np.integer) and not isinstance(position, bool)
        if not is_number or not 0 <= position < len(self._models):
            raise ValueError(
                f"{self._owner} chose position {position!r} in a window of {len(self._models)}"
            )
        model, score = self._models.item(position), self._scores.item(position)
        return Candidate(model, score, reason, is_fallback)


class Selection:
    """Candidates in the order in which they are to be tried (none: "skip"), how many of them the
    selector ``chosen`` itself (the fallback is not), and how many of the window's scores were
    ``undefined`` (NaN)."""

    __slots__ = ("candidates", "chosen", "undefined")

    def __init__(
        self, candidates: Sequence[Candidate], undefined: int = 0, chosen: int | None = None
    ) -> None:
        self.candidates, self.undefined = candidates, undefined
        self.chosen = chosen if chosen is not None else sum(not c.is_fallback for c in candidates)

    def __repr__(self) -> str:
        return f"Selection({tuple(self.candidates)!r}, undefined={self.undefined})"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Selection):
            return NotImplemented
        mine, theirs = (tuple(s.candidates) for s in (self, other))
        return mine == theirs and self.undefined == other.undefined


class Trial(NamedTuple):
    """A candidate whose registration was accepted; scans and points of what it was registered
    to (None: not known), and the restart that it came from ("": the guess)."""

    candidate: Candidate
    model: Node
    result: RegistrationResult
    target_scans: int | None = None
    target_points: int | None = None
    restart: str = ""


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
    needs_scans: bool = False
    """True: ``see`` is given every scan, without its ground truth."""
    needs_check: bool = False
    """True: refused together with a check that accepts everything."""
    tries_all: bool = False
    """True: every candidate is registered, and ``pick`` chooses among those that are accepted."""
    edges: int = 1
    """How many accepted registrations become edges of the scan; of several the pose is what agrees
    best with all. More than 1 needs ``covariance_from``."""
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

    def see(self, scan: Scan) -> None:  # noqa: B027 (only with needs_truth or needs_scans)
        """Every scan before it is selected for, with its ground truth only if ``needs_truth``."""

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
        last = self._fallback(scores)
        fallback = None if last is None else (last, f"fallback {self.fallback}")
        candidates = Candidates(tried, models, scores, fallback, type(self).__name__)
        undefined = int(np.count_nonzero(np.isnan(scores))) if self.needs_scores else 0
        return Selection(candidates, undefined, len(tried))

    def _fallback(self, scores: Array) -> int | None:
        newest = len(scores) - 1
        if self.fallback == "skip":
            return None
        if self.fallback == "previous" or np.isnan(scores).all():
            return newest
        return int(np.nanargmax(scores))


def keyframes_or_scans(
    content: Content, distance: float | None, angle_deg: float
) -> Keyframes | None:
    """The window's rule for ``content``: None keeps every scan."""
    return keyframes_every(distance, angle_deg) if content == "keyframes" else None


def keyframes_every(distance: float | None, angle_deg: float) -> Keyframes:
    """A keyframe every ``distance`` m. Raises ``ConfigError`` for None: a run takes it from the
    data before it makes the selector."""
    if distance is None:
        raise ConfigError("the keyframe distance is not set: expected m, or a run on data")
    return Keyframes(distance, angle_deg)
