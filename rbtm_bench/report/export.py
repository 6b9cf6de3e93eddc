"""A run in the formats of others: whole or not at all, and never over a file that is there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rbtm_bench.core import escape
from rbtm_bench.core.bounded import read_bytes, read_parquet, read_text
from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.files import write_atomically
from rbtm_bench.runs.stored import Run

if TYPE_CHECKING:
    import pandas as pd

POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
"""m and the unit quaternion of T_world_scan: the columns of a TUM file after its stamp."""


def export(run: Run, kind: str, out: Path) -> None:
    """Write a run as one of ``FORMATS``.

    Raises ``ConfigError`` if ``out`` is there already, ``DataError`` for a run without a
    trajectory or with damaged files, ``WriteError`` where ``out`` cannot be written.
    """
    if out.exists() or out.is_symlink():
        raise ConfigError(f"{out}: is there already; --out names another file")
    if not run.done:
        raise DataError(f"{run.path}: the run is {run.record.get('status')}: nothing to export")
    write = FORMATS[kind](run)
    write_atomically(out, write)


def steps_with_poses(run: Run) -> pd.DataFrame:
    """A row a scan: its number and stamp (s), its pose, and how it got it (docs/metrics.md)."""
    steps: pd.DataFrame = read_parquet(run.path / "steps.parquet").to_pandas()
    poses = _poses(run)
    if len(poses) != len(steps):
        raise DataError(f"{run.path}: {len(poses)} poses for {len(steps)} scans")
    for number, name in enumerate(POSE):
        steps.insert(2 + number, name, poses[:, 1 + number])
    return steps


def _poses(run: Run) -> Any:
    """The rows (N, 8) of trajectory.tum."""
    path = run.path / "trajectory.tum"
    try:
        rows = np.loadtxt(read_text(path).splitlines(), ndmin=2)
    except ValueError as error:
        raise DataError(f"{path}: cannot be read: {error}") from error
    if rows.shape[1] != 1 + len(POSE):
        raise DataError(f"{path}: {rows.shape[1]} columns: expected {1 + len(POSE)}")
    return rows


Write = Callable[[Path], object]


def _csv(run: Run) -> Write:
    table = steps_with_poses(run)
    for name in table:
        if table[name].map(lambda cell: isinstance(cell, np.ndarray | list)).any():
            table[name] = table[name].map(_words)
    table = escape.csv_table(table)
    return lambda path: table.to_csv(path, index=False)


def _words(cell: Any) -> Any:
    """A list of numbers as one cell."""
    return cell if cell is None else " ".join(repr(float(number)) for number in cell)


def _parquet(run: Run) -> Write:
    table = steps_with_poses(run)
    return lambda path: table.to_parquet(path, index=False)


def _tum(run: Run) -> Write:
    _poses(run)  # that it is one
    content = read_bytes(run.path / "trajectory.tum")
    return lambda path: path.write_bytes(content)


def _g2o(run: Run) -> Write:
    path = run.path / "graph.g2o"
    if not path.is_file():
        raise DataError(f"{run.path}: has no pose graph: a run with loops= keeps one")
    content = read_bytes(path)
    return lambda partial: partial.write_bytes(content)


FORMATS: dict[str, Callable[[Run], Write]] = {
    "csv": _csv,
    "parquet": _parquet,
    "tum": _tum,
    "g2o": _g2o,
}
"""Formats by name: what reads a run and gives the function that writes it."""
