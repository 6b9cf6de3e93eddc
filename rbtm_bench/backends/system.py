"""What a system is: a whole odometry of its own, which needs nobody to choose model scans.

A ``Backend`` registers pairs of scans and remembers nothing; a ``System`` is fed every scan in
order and keeps what it likes: a map, a motion model, thresholds that adapt. It stands in the group
``backend``, and the groups that choose model scans and guesses do nothing for it.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

import numpy as np

from rbtm_bench.backends.base import MIN_POINTS, PROGRAMMING_ERRORS, checked_motion
from rbtm_bench.core.errors import BackendError, one_line
from rbtm_bench.core.geometry import to_plane
from rbtm_bench.core.types import Array, Scan


@dataclass(frozen=True, eq=False)
class Tracked:
    """Where a system places a scan: T_world_scan (4, 4), and the seconds that it took.

    ``converged`` is False where the pose is a prediction that the scan did not confirm, None
    where the system does not say.
    """

    T_world_scan: Array
    converged: bool | None = None
    seconds: float = 0.0


class Tracker(ABC):
    """A system at work on one sequence. A plug-in writes ``place``."""

    @abstractmethod
    def place(self, points: Array, planar: bool) -> tuple[Array, bool | None]:
        """T_world_scan (4, 4) of the next scan, points (N, 3) m, and whether it is more than a
        prediction (None: not known). The world's origin is the system's to choose.

        Raises ``BackendError``, and stays as it was, for points that it cannot use.
        """

    def track(self, scan: Scan) -> Tracked:
        """Place the next scan of the sequence; a planar one in the plane.

        Raises ``BackendError``, and goes on with the next scan as if this one had not come, for
        points that are not finite or fewer than 6, or if the library fails. What a wrong plug-in
        raises (``PROGRAMMING_ERRORS``) comes out as it is.
        """
        points = np.array(scan.points, dtype=np.float64, order="C")  # the scan's stay as they are
        if points.ndim != 2 or points.shape[1] != 3:
            raise BackendError(f"scan {scan.index}: points {points.shape}: expected (N, 3)")
        if not np.isfinite(points).all():
            raise BackendError(f"scan {scan.index}: some points are not finite")
        if len(points) < MIN_POINTS:
            raise BackendError(
                f"scan {scan.index}: {len(points)} points: expected at least {MIN_POINTS}"
            )
        started = time.perf_counter()
        try:
            placed, converged = self.place(points, scan.planar)
        except BackendError as error:
            raise BackendError(f"scan {scan.index}: {one_line(error)}") from error
        except PROGRAMMING_ERRORS:
            raise
        except Exception as error:
            name = type(self).__name__
            raise BackendError(f"{name}: {type(error).__name__}: {one_line(error)}") from error
        seconds = time.perf_counter() - started
        T = checked_motion(placed, type(self).__name__)
        return Tracked(to_plane(T) if scan.planar else T, converged, seconds)


class System(ABC):
    """Makes trackers: one for every run, which knows nothing of the others."""

    requires: tuple[str, ...] = ()
    """Names of the Python packages that must be importable."""
    library: str = ""
    converged_means: str = "not reported by the library"
    repeats: str = "same bits"
    """As those of ``Backend``: for the page of backends."""
    dimensions: tuple[Literal["2d", "3d"], ...] = ("2d", "3d")
    """What the system can follow: planar scans ("2d"), clouds in space ("3d")."""

    @abstractmethod
    def start(self) -> Tracker:
        """A fresh tracker, before its first scan."""
