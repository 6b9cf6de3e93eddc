"""Control: RBTM's own gaps, in their order, at other times: does *when* it reaches back matter?"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt
from numpy.typing import NDArray

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.kinds import Distance, OtherRun, Seed
from rbtm_bench.core.types import Array
from rbtm_bench.selection.base import Content, Selector, keyframes_or_scans
from rbtm_bench.selection.fixed_gap import nearest_gap
from rbtm_bench.selection.random_gap import gaps_by_scan
from rbtm_bench.selection.window import Window

Gap = Annotated[int, Ge(0)]


class ShiftedGap(Selector):
    """Scan i takes the gap that another run had at scan 1 + (i - 1 + ``offset``) mod m.

    The m gaps are those of all scans but the first, so a rotation has the same gaps, as often, in
    the same runs of long and short ones, and as many scans that are registered to nothing (gap 0).
    ``offset=0`` is the other run again. A gap that reaches behind the window takes its oldest
    member; the window's settings are RBTM's own, so that a target has as much to be made of.
    ``gaps_from`` is the other run's folder, ``gaps_sha256`` the ``digest`` that its gaps must have
    (None: any); or ``gaps`` lists them.
    """

    requires = ("pyarrow",)

    def __init__(
        self,
        window: Annotated[int, Ge(2)] = 10,
        offset: Seed = 1,
        gaps_from: OtherRun = None,
        gaps_sha256: OtherRun = None,
        gaps: Sequence[Gap] | None = None,
        content: Content = "scans",
        keyframe_distance: Distance | None = 0.3,
        keyframe_angle_deg: Annotated[float, Gt(0)] = 15.0,
        keyframe_distance_relative: Annotated[float, Gt(0)] | None = None,
        window_m: Distance | None = None,
    ) -> None:
        if (gaps_from is None) == (not gaps):
            raise ConfigError(
                "selector=shifted_gap: expected either selector.gaps_from=<run folder> "
                "or selector.gaps=[...]"
            )
        self.gaps = list(gaps) if gaps else sequence(Path(str(gaps_from)))
        if gaps_sha256 not in (None, digest(self.gaps)):
            raise DataError(
                f"selector.gaps_from={gaps_from}: its gaps are not those of "
                f"selector.gaps_sha256={gaps_sha256}: the run was made again, by other settings"
            )
        self.offset = offset
        self._keyframes = keyframes_or_scans(content, keyframe_distance, keyframe_angle_deg)
        self._window_m = window_m
        super().__init__(window - 1, "previous" if all(self.gaps) else "skip")

    def window(self) -> Window:
        return Window(self.capacity, self._keyframes, self._window_m)

    def order(self, scan: int, models: NDArray[np.int64], scores: Array) -> list[tuple[int, str]]:
        gap = self.gaps[(scan - 1 + self.offset) % len(self.gaps)]
        return [(nearest_gap(scan, models, gap), f"shifted gap {gap}")] if gap else []


def sequence(run: Path) -> list[int]:
    """The gaps of all scans of a run but the first, 0 for those that are registered to nothing.
    Raises ``DataError`` if none is registered."""
    gaps = [gap or 0 for gap in gaps_by_scan(run)[1:]]
    if not any(gaps):
        raise DataError(f"{run}: the run has no registered scan to take a gap from")
    return gaps


def digest(gaps: Sequence[int]) -> str:
    """Equal for equal sequences."""
    return hashlib.sha256(json.dumps(list(gaps)).encode()).hexdigest()[:16]
