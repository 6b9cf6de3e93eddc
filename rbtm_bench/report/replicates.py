"""A method's runs over replicates: what counts, and how far apart they are.

Replicates are perturbed copies of one data set (``datasets.perturbed``). A method's value is the
median over those; the run on the data as they are stands beside.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rbtm_bench.core.bounded import read_bytes, read_json
from rbtm_bench.core.errors import DataError
from rbtm_bench.runs.evaluation import COMMON
from rbtm_bench.runs.identity import node_key
from rbtm_bench.runs.stored import Run, is_number

Draw = tuple[str, int, int]
"""What a run shares with other methods' runs: data set, number and seed of the replicate."""

OF_MAIN = ("q1", "q3", "worst", "unperturbed")
"""Ends of the columns that stand behind a main error where there are replicates."""


SHIFTED = "shifted_gap"
"""The selector whose runs are rotations of one run's gaps: together they are one row."""


def number_of(run: Run) -> int:
    """Which replicate a run is; 0: the data as they are."""
    return int((run.record.get("replicate") or {}).get("number") or 0)


def data_set(run: Run) -> str:
    """What makes its data another data set, replicates or not: their fingerprint before any
    perturbation, or else its settings."""
    copied = (run.record.get("replicate") or {}).get("of")
    fingerprint = copied or run.record.get("dataset_fingerprint")
    return str(fingerprint or node_key(run.identity.dataset, run.identity.seed))


def draw_of(run: Run) -> Draw:
    """Runs of two methods with the same draw saw the same data."""
    seed = (run.record.get("replicate") or {}).get("seed") or 0
    return data_set(run), number_of(run), int(seed)


def trajectory_of(run: Run) -> str:
    """Equal for trajectories that are equal to the bit."""
    known = run.record.get("trajectory_sha256")
    file = run.path / "trajectory.tum"
    if known is None and file.is_file():
        return hashlib.sha256(read_bytes(file)).hexdigest()
    return str(known or run.path)


def value_of(run: Run, key: str) -> float | None:
    """A metric of a run, of an unperturbed one over the scans that its replicates have too."""
    value = run.metrics.get(key)
    if number_of(run) == 0:
        value = _common(run.path).get(key, value)
    return float(value) if value is not None and is_number(value) else None


def _common(folder: Path) -> dict[str, Any]:
    try:
        return read_json(folder / COMMON)
    except DataError:
        return {}


def counted(runs: Sequence[Run]) -> list[Run]:
    """The runs that a method's numbers are medians of: on every data set its replicates, of those
    with equal trajectories the first; where there are none all runs."""
    copied = {data_set(run) for run in runs if number_of(run) and run.done}
    kept: list[Run] = []
    seen: set[tuple[str, str]] = set()
    for run in runs:
        data = data_set(run)
        if data in copied:
            trajectory = (data, trajectory_of(run))
            if number_of(run) == 0 or not run.done or trajectory in seen:
                continue
            seen.add(trajectory)
        kept.append(run)
    return kept


@dataclass(frozen=True)
class Spread:
    """One metric over the distinct replicates of a method; ``unperturbed`` is the run on the data
    as they are, None if there is none."""

    median: float
    q1: float
    q3: float
    best: float
    worst: float
    distinct: int
    unperturbed: float | None

    @property
    def outside(self) -> bool:
        """Whether the unperturbed run is none of what its replicates span."""
        return self.unperturbed is not None and not self.best <= self.unperturbed <= self.worst


def spread(runs: Sequence[Run], key: str) -> Spread | None:
    """The spread of an error (of which less is better) over replicates, or over rotations; None
    without any that have it."""
    rotated = [run for run in runs if run.choices.get("selector") == SHIFTED and run.done]
    copies = rotated or [run for run in counted(runs) if number_of(run)]
    values = [v for v in (value_of(run, key) for run in copies) if v is not None]
    if not values:
        return None
    q1, median, q3 = (float(q) for q in np.quantile(values, [0.25, 0.5, 0.75]))
    alone = [run for run in runs if run.done and number_of(run) == 0 and not rotated]
    plain = [value_of(run, key) for run in alone]
    known = [value for value in plain if value is not None]
    unperturbed = float(np.median(known)) if known else None
    return Spread(median, q1, q3, min(values), max(values), len(values), unperturbed)


def spread_columns(runs: Sequence[Run], keys: Sequence[str]) -> dict[str, dict[str, float | None]]:
    """For every one of the errors with replicates what stands behind its column."""
    columns: dict[str, dict[str, float | None]] = {}
    for key in keys:
        over = spread(runs, key)
        if over is not None:
            columns[key] = {f"{key}_{end}": getattr(over, end) for end in OF_MAIN}
            if runs[0].choices.get("selector") == SHIFTED:
                columns[key][key] = over.median
    return columns
