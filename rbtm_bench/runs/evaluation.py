"""What the metrics make of a run's trajectory, over the scans that are evaluated."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rbtm_bench.core.columns import REFERENCES
from rbtm_bench.core.errors import DataError
from rbtm_bench.core.files import write_json
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.loop_columns import LOOPED
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.datasets.association import nearest
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.datasets.perturbed import Since, measured
from rbtm_bench.metrics.base import Metric, evaluated
from rbtm_bench.metrics.relation_errors import FILE as RELATIONS
from rbtm_bench.metrics.relations import RelationError
from rbtm_bench.runs.replicate import of_data

COMMON = "metrics_common.json"
"""The numbers of an unperturbed run over the scans that its replicates have too."""


def evaluate(
    metrics: Sequence[Metric],
    estimate: Trajectory,
    truth: Trajectory | None,
    dataset: Dataset,
    first: int,
    known: dict[str, Any] | None = None,
    looped: Trajectory | None = None,
) -> tuple[dict[str, Any], Any]:
    """What is ``known``, every number of the poses from scan ``first`` on, and the error of every
    relation if there are relations: one that begins before has none. With ``looped`` the same
    numbers of that trajectory, behind ``looped_``."""
    if first:
        dataset, estimate = Since(dataset, first), estimate.since(first)
        truth = None if truth is None else truth.since(first)
        looped = None if looped is None else looped.since(first)
    values: dict[str, Any] = dict(known or {})
    errors = None
    for metric in metrics:
        values |= evaluated(metric, estimate, truth, dataset, taken=values)
        if isinstance(metric, RelationError) and dataset.relations is not None:
            errors = metric.errors(estimate, dataset.relations)
    if looped is not None:
        for metric in metrics:
            again = evaluated(metric, looped, truth, dataset).items()
            own = {k: v for k, v in again if not k.endswith(tuple(REFERENCES))}
            values |= {f"{LOOPED}{key}": value for key, value in own.items()}
    return values, errors


def truth_of(dataset: Dataset) -> Trajectory | None:
    """The true poses of a data set's scans, NaN where one is not known; None without any.
    Raises ``DataError`` for a data set that knows no relations either."""
    if not dataset.has_ground_truth:
        if dataset.relations is None:
            raise DataError("the data set has neither a ground truth nor relations")
        return None
    unknown = np.full((4, 4), np.nan)
    scans = [(s.stamp, unknown if s.ground_truth is None else s.ground_truth) for s in dataset]
    return Trajectory(np.array([stamp for stamp, _ in scans]), np.stack([T for _, T in scans]))


def by_time(
    estimate: Trajectory, truth: Trajectory, tolerance_s: float
) -> tuple[Trajectory, Trajectory]:
    """The poses of both that belong together, at most ``tolerance_s`` s apart. Raises
    ``DataError`` if none do."""
    at = nearest(truth.stamps, estimate.stamps, tolerance_s)
    near = at >= 0
    if not near.any():
        raise DataError(f"no two poses are within {tolerance_s:g} s of each other")
    return (
        Trajectory(estimate.stamps[near], estimate.T_world_scan[near]),
        Trajectory(truth.stamps[at[near]], truth.T_world_scan[at[near]]),
    )


def write_metrics(
    out: Path,
    of_steps: dict[str, Any],
    metrics: Sequence[Metric],
    estimate: Trajectory,
    truth: Trajectory | None,
    dataset: Dataset,
    looped: Trajectory | None = None,
) -> None:
    """``metrics.json`` and, with relations, ``relations.parquet``."""
    first = dataset.scored_from
    values, errors = evaluate(metrics, estimate, truth, dataset, first, of_steps, looped)
    if errors is not None:
        errors.write(out / RELATIONS)
    write_json(out / "metrics.json", values)


def write_common(
    out: Path,
    config: dict[str, Any],
    metrics: Sequence[Metric],
    estimate: Trajectory,
    truth: Trajectory | None,
    dataset: Dataset,
    looped: Trajectory | None = None,
) -> None:
    """``metrics_common.json`` of an unperturbed run that has replicates."""
    if config.get("replicate") or config.get("replicates", 1) < 2:
        return
    first = measured(dataset).latest_start(of_data(config))
    write_json(out / COMMON, evaluate(metrics, estimate, truth, dataset, first, None, looped)[0])


def checksum(estimate: Trajectory, first: int) -> str:
    """Equal for runs whose poses from scan ``first`` on, seen from that scan, are the same to the
    bit."""
    T = estimate.T_world_scan[first:]
    relative = inverse(T[0]) @ T + 0.0  # no -0.0
    return hashlib.sha256(np.ascontiguousarray(relative).tobytes()).hexdigest()
