"""What strategies share whose candidates are the window's members of enough similarity."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
from annotated_types import Ge, Gt
from numpy.typing import NDArray

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.kinds import Distance, OpenThreshold
from rbtm_bench.core.types import Array, Node
from rbtm_bench.selection.base import (
    Content,
    Fallback,
    Selection,
    Selector,
    keyframes_or_scans,
)
from rbtm_bench.selection.window import Window

AUTO = "auto"


class ThresholdSelector(Selector):
    """Candidates are the members of the window whose similarity exceeds ``threshold``; strategies
    differ in their order alone, so that the same settings give all of them the same to choose from.

    ``window`` counts the new scan, as in the paper: w - 1 past scans. ``fallback`` says what
    follows when none passes or all are rejected: "previous" is the newest member of the window,
    "best" the most similar one, "skip" nothing: the scan is left at its predicted pose and is no
    model scan for others. After ``restart_after`` such scans in a row (None: ``window``) the next
    may be matched to the one before it: a restart. ``content="keyframes"`` fills the window with
    scans that moved ``keyframe_distance`` m or ``keyframe_angle_deg`` by estimate; every scan is
    still registered. With ``window_m`` members farther back than so many metres travelled, by
    estimate, are let go as well. In a run ``threshold`` "auto" and, where ``keyframe_distance`` is
    None, ``keyframe_distance_relative`` (times the median range) are replaced by what the data's
    first part says (``runs.first_part``).
    """

    needs_scores = True
    idle_settings: ClassVar[dict[str, Any]] = {
        "keyframe_distance": ("content", "scans"),
        "keyframe_angle_deg": ("content", "scans"),
        "keyframe_distance_relative": (("content", "scans"), ("keyframe_distance", ...)),
    }

    def __init__(
        self,
        window: Annotated[int, Ge(2)] = 10,
        threshold: OpenThreshold = 0.7,
        fallback: Fallback = "previous",
        restart_after: Annotated[int, Ge(1)] | None = None,
        content: Content = "scans",
        keyframe_distance: Distance | None = 0.3,
        keyframe_angle_deg: Annotated[float, Gt(0)] = 15.0,
        keyframe_distance_relative: Annotated[float, Gt(0)] | None = None,
        window_m: Distance | None = None,
    ) -> None:
        super().__init__(window - 1, fallback, restart_after)
        self.threshold = threshold
        self.passed = f"S > {threshold}" if threshold == AUTO else f"S > {threshold:g}"
        self._keyframes = keyframes_or_scans(content, keyframe_distance, keyframe_angle_deg)
        self._window_m = window_m

    def window(self) -> Window:
        return Window(self.capacity, self._keyframes, self._window_m)

    def passing(self, scores: Array) -> list[int]:
        """Positions of the members that pass, oldest first."""
        if isinstance(self.threshold, str):
            raise ConfigError("selector.threshold=auto: expected a number, or a run on data")
        # NaN > threshold is False: an undefined score never passes
        passing: list[int] = np.flatnonzero(scores > self.threshold).tolist()
        return passing


class ChainSelector(ThresholdSelector):
    """A strategy that orders by what lies behind a member: its pose, hops, covariance.

    A plug-in writes ``order_nodes`` instead of ``order``.
    """

    @abstractmethod
    def order_nodes(self, nodes: Sequence[Node], scores: Array) -> list[tuple[int, str]]:
        """As ``order``, with the window's members (W), oldest first."""

    def choose(self, scan: int, window: Window, scores: Array) -> Selection:
        tried = self.order_nodes(window.nodes, scores)
        return self.selection(tried, window.scans, scores)

    def order(self, scan: int, models: NDArray[np.int64], scores: Array) -> list[tuple[int, str]]:
        """Not possible by numbers alone: raises ``TypeError``."""
        raise TypeError(f"{type(self).__name__} orders nodes, not numbers: call choose()")
