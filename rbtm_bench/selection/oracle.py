"""NOT A METHOD, it SEES THE GROUND TRUTH: the candidate that truth says registers best."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt
from numpy.typing import NDArray

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.geometry import inverse, transform
from rbtm_bench.core.kinds import Distance
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.selection.base import Content, Selector, Trial, keyframes_or_scans
from rbtm_bench.selection.window import Window


class Oracle(Selector):
    """Registers the new scan to every member of the window and keeps the registration that is
    nearest to the truth: a bound for those who must choose beforehand, never a result of its own.

    How near is one number in m: the root mean square displacement of the scan's points between
    where the estimate and where the truth puts them (a turn counts by what it moves). ``by``
    says which estimate: "registration" compares T_model_scan with the true motion of the pair,
    "pose" the scan's pose by way of that model scan with the true pose, both relative to the
    first scan. Of equals the older model scan is kept. The choice is greedy: the best pair now
    need not make the best trajectory. ``window`` and ``content`` as in ``Rbtm``.

    Raises ``DataError`` for a scan without ground truth.
    """

    needs_truth = True
    tries_all = True

    def __init__(
        self,
        window: Annotated[int, Ge(2)] = 10,
        by: Literal["registration", "pose"] = "registration",
        content: Content = "scans",
        keyframe_distance: Distance | None = 0.3,
        keyframe_angle_deg: Annotated[float, Gt(0)] = 15.0,
        keyframe_distance_relative: Annotated[float, Gt(0)] | None = None,
        window_m: Distance | None = None,
    ) -> None:
        super().__init__(capacity=window - 1)
        self.by = by
        self._keyframes = keyframes_or_scans(content, keyframe_distance, keyframe_angle_deg)
        self._window_m = window_m
        self._truth: dict[int, Array] = {}

    def window(self) -> Window:
        self._truth = {}  # a new run begins
        return Window(self.capacity, self._keyframes, self._window_m)

    def see(self, scan: Scan) -> None:
        if scan.ground_truth is None:
            raise DataError(
                f"selector=oracle: scan {scan.index} has no ground truth: every scan needs one"
            )
        self._truth[scan.index] = scan.ground_truth

    def order(self, scan: int, models: NDArray[np.int64], scores: Array) -> list[tuple[int, str]]:
        return [(i, "truth decides") for i in range(len(models))]

    def pick(self, scan: Scan, trials: Sequence[Trial]) -> tuple[int, str]:
        off = [self.error(scan, trial) for trial in trials]
        best = int(np.argmin(off))
        return best, f"truth seen: {self.by} {off[best]:.4f} m off, best of {len(off)}"

    def error(self, scan: Scan, trial: Trial) -> float:
        """How far (m, RMS) a registration puts the scan's points from where they truly are."""
        T_model_scan = trial.result.T_target_source
        if self.by == "registration":
            true = inverse(self._truth[trial.model.scan]) @ self._truth[scan.index]
            return rms_displacement(inverse(true) @ T_model_scan, scan.points)
        first = next(iter(self._truth.values()))
        true = inverse(first) @ self._truth[scan.index]
        estimate = trial.model.T_world_scan @ T_model_scan
        return rms_displacement(inverse(true) @ estimate, scan.points)


def rms_displacement(T: Array, points: Array) -> float:
    """How far (m, root mean square) a motion (4, 4) moves points (N, 3), N >= 1."""
    return float(np.sqrt(np.mean(np.sum((transform(T, points) - points) ** 2, axis=1))))
