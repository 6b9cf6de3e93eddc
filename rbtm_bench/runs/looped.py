"""A run's loops: closed after its last scan, and what is kept of that."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rbtm_bench.core.rigid import rigidity
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array, Scan, read_only
from rbtm_bench.datasets.base import ATTRIBUTES, Dataset
from rbtm_bench.loops.base import Loops, Route
from rbtm_bench.metrics.base import Values
from rbtm_bench.odometry.method import Work

FILES = ("looped.tum", "graph.g2o")
TOLERANCE = 1e-9
"""How far from rigid a pose may be."""


class WithoutTruth(Dataset):
    """A data set as what closes loops may see it: no ground truth, no relations."""

    def __init__(self, dataset: Dataset) -> None:
        self._dataset = dataset
        for name in ATTRIBUTES:
            setattr(self, name, getattr(dataset, name))
        self.has_ground_truth = False

    def __len__(self) -> int:
        return len(self._dataset)

    def __getitem__(self, index: int) -> Scan:
        return self._dataset[index].without_truth()

    def fingerprint(self) -> str:
        return self._dataset.fingerprint()


def close_loops(
    loops: Loops | None,
    route: Route,
    stamps: Array,
    dataset: Dataset,
    work: Work | None,
    out: Path,
) -> tuple[Trajectory | None, Values]:
    """The trajectory with loops closed and the numbers of the family "loops" (None and none
    without), ``looped.tum`` and ``graph.g2o`` written. Raises ``ValueError`` for poses that are
    none."""
    if loops is None or work is None or not route.scans:
        return None, {}
    closing = loops.close(route, WithoutTruth(dataset), work)
    if closing is None:
        return None, {}
    from rbtm_bench.graph.g2o import write_g2o  # brings scipy

    poses = np.asarray(closing.T_world_scan, dtype=np.float64)
    if poses.shape != (len(stamps), 4, 4) or not all(rigidity(T) <= TOLERANCE for T in poses):
        name, shape = type(loops).__name__, poses.shape
        raise ValueError(f"{name}.close returned poses {shape}: expected a rigid one a scan")
    looped = Trajectory(stamps, read_only(poses))
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
