"""The positive control of ``placebo.py``: a method's twin that is worse by a known factor."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd
from scipy.optimize import brentq

from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.datasets.perturbed import Since
from rbtm_bench.runs import assembly
from rbtm_bench.runs.evaluation import evaluate
from rbtm_bench.runs.stored import Run


def shrink_for(factor: float, error_of: Sequence[Callable[[float], float]], values: Array) -> float:
    """The shrinking at which the median error is so many times as large."""
    aim = factor * float(np.median(values))

    def off(shrunk: float) -> float:
        return float(np.median([error(shrunk) for error in error_of])) - aim

    high = 0.01
    while off(high) < 0 and high < 1.0:
        high *= 1.5
    return float(brentq(off, 0.0, min(high, 1.0), xtol=1e-5)) if off(min(high, 1.0)) > 0 else 1.0


def twin_error(run: Run, key: str) -> Callable[[float], float]:
    """The error of the run's twin by the share that its registered translations are shrunk.

    Rotations stay, so a pose moves by that share of the registered motions on its chain. Shrunk
    are those made while the robot faced the way that it started: shrunk as a whole, a drive that
    comes back would close its loops all the better.
    """
    draw = run.record["replicate"]
    first = draw["scored_from_scan"] - draw["first_scan"]
    steps = pd.read_parquet(run.path / "steps.parquet")
    estimate = Trajectory.read_tum(run.path / "trajectory.tum")
    position = estimate.T_world_scan[:, :3, 3]
    registered = steps["status"].isin(["registered", "fallback"]).to_numpy()
    before = np.arange(len(steps)) - 1
    facing = estimate.T_world_scan[:, :3, 0] @ estimate.T_world_scan[0, :3, 0] > 0
    model = np.where(registered, steps["model"].fillna(-1).to_numpy(), before).astype(int)
    moved = np.zeros_like(position)
    for scan in range(1, len(steps)):
        shrinks = registered[scan] and facing[scan]
        own = position[scan] - position[model[scan]] if shrinks else 0.0
        moved[scan] = moved[model[scan]] + own
    dataset, truth = scored(run, draw["scored_from_scan"])
    metrics = [m for m in assembly.build_metrics(run.config) if key in m.columns]

    def error(shrunk: float) -> float:
        T = estimate.T_world_scan.copy()
        T[:, :3, 3] = position - shrunk * moved
        twin = Trajectory(estimate.stamps, T).since(first)
        return float(evaluate(metrics, twin, truth, dataset, 0)[0][key])

    return error


_opened: dict[str, Dataset] = {}


def scored(run: Run, first: int) -> tuple[Dataset, Trajectory | None]:
    """The part of the data that is evaluated, as it is, with its truth."""
    name = repr(run.config["dataset"])
    if name not in _opened:
        _opened[name] = assembly.build(run.config["dataset"])
    dataset = Since(_opened[name], first)
    if not dataset.has_ground_truth:
        return dataset, None
    scans = list(dataset)
    poses = np.array([scan.ground_truth for scan in scans])
    return dataset, Trajectory(np.array([scan.stamp for scan in scans]), poses)
