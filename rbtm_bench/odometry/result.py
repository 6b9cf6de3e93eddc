"""What becomes of a stream of scans, step by step or all at once."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array, Edge, Step, StepTable

if TYPE_CHECKING:
    import pandas as pd


class Odometry(Iterator[Step]):
    """Scans that are registered one after the other, each when it is asked for.

    Iterating gives what became of every scan (``T_world_scan`` (4, 4), ``record``, ``edges``) as
    soon as it is registered, before the next one is drawn from a live iterable. ``trajectory``,
    ``steps`` and ``edges`` register whatever is left first.

    Attributes
    ----------
    trajectory : Trajectory
        ``stamps`` (N,) s and ``T_world_scan`` (N, 4, 4); the first scan is the origin.
    steps : DataFrame
        A row a scan: the columns of steps.parquet (docs/metrics.md).
    edges : list of Edge
        The measured motions ``T_model_scan`` that the trajectory hangs on.
    """

    def __init__(self, stepping: Iterator[Step]) -> None:
        self._stepping = stepping
        self._poses: list[Array] = []
        self._table = StepTable()
        self._edges: list[Edge] = []

    def __next__(self) -> Step:
        step = next(self._stepping)
        self._poses.append(step.T_world_scan)
        self._edges += step.edges
        self._table.add(step.record)
        return step

    def _finish(self) -> None:
        for _ in self:
            pass

    @property
    def trajectory(self) -> Trajectory:
        self._finish()
        poses = np.stack(self._poses) if self._poses else np.empty((0, 4, 4))
        return Trajectory(np.array(self._table["stamp"], np.float64), poses)

    @property
    def steps(self) -> pd.DataFrame:
        import pandas as pd

        self._finish()
        return pd.DataFrame(self._table.columns)

    @property
    def edges(self) -> list[Edge]:
        self._finish()
        return self._edges
