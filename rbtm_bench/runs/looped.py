"""A run's loops: closed after its last scan, and what is kept of that."""

from __future__ import annotations

from pathlib import Path

from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array, read_only
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.loops.base import Loops, Route
from rbtm_bench.metrics.base import Values
from rbtm_bench.odometry.method import Work

FILES = ("looped.tum", "graph.g2o")


def close_loops(
    loops: Loops | None,
    route: Route,
    stamps: Array,
    dataset: Dataset,
    work: Work | None,
    out: Path,
) -> tuple[Trajectory | None, Values]:
    """The trajectory with loops closed and the numbers of the family "loops" (None and none
    without), ``looped.tum`` and ``graph.g2o`` written."""
    closing = loops.close(route, dataset, work) if loops and work and route.scans else None
    if closing is None:
        return None, {}
    from rbtm_bench.graph.g2o import write_g2o  # brings scipy

    looped = Trajectory(stamps, read_only(closing.T_world_scan))
    looped.write_tum(out / FILES[0])
    write_g2o(out / FILES[1], closing.graph)
    return looped, {
        "loops": closing.accepted,
        "loops_candidates": closing.candidates,
        "loops_rejected": closing.rejected,
        "loops_off": closing.turned_off,
        "loops_seconds": closing.seconds,
        "loops_ms_per_scan": 1e3 * closing.seconds / len(stamps),
    }
