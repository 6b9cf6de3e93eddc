"""No loops: the odometry as it is."""

from __future__ import annotations

from rbtm_bench.datasets.base import Dataset
from rbtm_bench.loops.base import Loops, Route
from rbtm_bench.odometry.method import Work


class NoLoops(Loops):
    """Looks for nothing."""

    is_off = True

    def close(self, route: Route, dataset: Dataset, work: Work) -> None:
        return None
