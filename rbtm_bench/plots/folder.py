"""What figures need from a run folder, as arrays. A file that is not there is None."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.errors import DataError
from rbtm_bench.geometry import inverse
from rbtm_bench.results import Run
from rbtm_bench.trajectory import Trajectory
from rbtm_bench.types import Array

DRAWN = 200_000
"""Points of a map that are drawn at most."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A run's map from above, m: ``points`` (M, 2) thinned, ``path`` (N, 2) estimated and
    ``truth`` (N, 2) true positions, the truth moved so that the first poses agree."""

    points: NDArray[np.float32]
    path: Array
    truth: Array | None
    planar: bool


@dataclass(frozen=True, eq=False)
class Steps:
    """Columns of ``steps.parquet``, (N,) each; NaN where there is no model scan or score.
    ``held`` is the smallest eigenvalue of the localizability."""

    scan: Array
    gap: Array
    score: Array
    held: Array
    status: NDArray[np.str_]


def read_scene(run: Run) -> Scene | None:
    """Map and trajectories, None without a map or a trajectory. Raises ``DataError``."""
    arrays = _npz(run.path / "map.npz", ("points",))
    if arrays is None or not (run.path / "trajectory.tum").is_file():
        return None
    points = arrays[0]
    if points.ndim != 2 or points.shape[1] != 3:
        raise DataError(f"{run.path / 'map.npz'}: points {points.shape}, expected (M, 3)")
    points = points[np.isfinite(points).all(axis=1)]
    planar = bool(len(points) == 0 or np.ptp(points[:, 2]) == 0.0)
    if len(points) > DRAWN:
        points = points[np.linspace(0, len(points) - 1, DRAWN).round().astype(np.int64)]
    T = Trajectory.read_tum(run.path / "trajectory.tum").T_world_scan
    truth = None
    if (run.path / "ground_truth.tum").is_file():
        G = Trajectory.read_tum(run.path / "ground_truth.tum").T_world_scan
        truth = (T[0] @ inverse(G[0]) @ G)[:, :2, 3]
    return Scene(points[:, :2], T[:, :2, 3], truth, planar)


def read_steps(run: Run) -> Steps | None:
    """The steps, None without their file or any row. Raises ``DataError``."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = run.path / "steps.parquet"
    if not path.is_file():
        return None
    try:
        names = ("scan", "gap", "score", "localizability_min")
        table = pq.read_table(path, columns=[*names, "status"])
        scan, gap, score, held = (table[name].to_numpy().astype(np.float64) for name in names)
        status = np.array([str(word) for word in table["status"].to_pylist()])
    except (pa.ArrowException, OSError, KeyError, ValueError) as error:
        raise DataError(f"{path}: not a readable table of steps: {_line(error)}") from error
    return Steps(scan, gap, score, held, status) if len(scan) else None


def read_similarity(run: Run) -> tuple[Array, Array] | None:
    """Scan numbers (K,) and scores (K, K); None without their file. Raises ``DataError``."""
    path = run.path / "similarity.npz"
    arrays = _npz(path, ("scans", "scores"))
    if arrays is None:
        return None
    scans, scores = (np.asarray(array, dtype=np.float64) for array in arrays)
    if scores.shape != (len(scans), len(scans)):
        raise DataError(f"{path}: scores {scores.shape} for {len(scans)} scans")
    return (scans, scores) if len(scans) else None


def _npz(path: Path, names: tuple[str, ...]) -> list[NDArray[Any]] | None:
    if not path.is_file():
        return None
    try:
        with np.load(path) as archive:
            return [archive[name] for name in names]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise DataError(f"{path}: not readable: {_line(error)}") from error


def _line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
