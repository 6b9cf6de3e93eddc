"""What figures need from a run folder, as arrays. A missing file is None."""

from __future__ import annotations

import math
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.bounded import read_parquet
from rbtm_bench.core.errors import DataError
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.files import UNPACKED_ALWAYS, UNPACKED_TIMES
from rbtm_bench.runs.occupancy import Occupancy
from rbtm_bench.runs.stored import Run

NEWER = "localizability_min"
"""A column that runs of version 0.1.0 do not have."""
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
class Paths:
    """A run's poses: ``truth`` has as many as ``estimate``, in its own frame; None if unknown."""

    estimate: Trajectory
    truth: Trajectory | None

    @property
    def truth_from_start(self) -> Array | None:
        """The true poses (N, 4, 4), moved so that the first agrees with the first estimated."""
        if self.truth is None:
            return None
        first = self.estimate.T_world_scan[0]
        return first @ inverse(self.truth.T_world_scan[0]) @ self.truth.T_world_scan


@dataclass(frozen=True, eq=False)
class Steps:
    """Columns of ``steps.parquet``, (N,) each; NaN without a model scan or score.
    ``held`` is the smallest eigenvalue of the localizability."""

    scan: Array
    gap: Array
    score: Array
    held: Array
    status: NDArray[np.str_]


def read_scene(run: Run) -> Scene | None:
    """Map and trajectories, None without a map or a trajectory. Raises ``DataError``."""
    arrays, paths = _npz(run.path / "map.npz", ("points",)), read_paths(run)
    if arrays is None or paths is None:
        return None
    points = arrays[0]
    if points.ndim != 2 or points.shape[1] != 3:
        raise DataError(f"{run.path / 'map.npz'}: points {points.shape}, expected (M, 3)")
    points = points[np.isfinite(points).all(axis=1)]
    planar = bool(len(points) == 0 or np.ptp(points[:, 2]) == 0.0)
    if len(points) > DRAWN:
        points = points[np.linspace(0, len(points) - 1, DRAWN).round().astype(np.int64)]
    G = paths.truth_from_start
    truth = None if G is None else G[:, :2, 3]
    return Scene(points[:, :2], paths.estimate.T_world_scan[:, :2, 3], truth, planar)


def read_paths(run: Run) -> Paths | None:
    """The trajectories, None without an estimated one. Raises ``DataError``."""
    path, true = run.path / "trajectory.tum", run.path / "ground_truth.tum"
    if not path.is_file():
        return None
    estimate = Trajectory.read_tum(path)
    truth = Trajectory.read_tum(true) if true.is_file() else None
    if truth is not None and len(truth) != len(estimate):
        raise DataError(f"{true}: {len(truth)} poses, expected {len(estimate)} as in {path.name}")
    return Paths(estimate, truth)


def read_occupancy(run: Run) -> Occupancy | None:
    """The grid kept with the map, None for a run without (in space, or an old one). Raises
    ``DataError``."""
    path = run.path / "map.npz"
    arrays = _npz(path, ("hits", "passed", "corner", "cell"), optional=True)
    if arrays is None:
        return None
    hits, passed, corner, cell = arrays
    fits = hits.shape == passed.shape and hits.ndim == 2 and corner.shape == (2,)
    if not fits or cell.shape != () or not cell > 0:
        raise DataError(f"{path}: hits {hits.shape}, passed {passed.shape}: not a grid")
    counts = [array.astype(np.uint32) for array in (hits, passed)]
    return Occupancy(counts[0], counts[1], corner.astype(np.float64), float(cell))


def read_steps(run: Run) -> Steps | None:
    """The steps, None without their file or any row. Raises ``DataError``."""
    path = run.path / "steps.parquet"
    if not path.is_file():
        return None
    names = ["scan", "gap", "score", "status"]
    table = read_parquet(path, [*names, NEWER])
    known = NEWER in table.column_names
    try:
        scan, gap, score = (table[name].to_numpy().astype(np.float64) for name in names[:3])
        held = table[NEWER].to_numpy().astype(np.float64) if known else np.full(len(scan), np.nan)
        status = np.array([str(word) for word in table["status"].to_pylist()])
    except (KeyError, ValueError) as error:
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


def _npz(path: Path, names: tuple[str, ...], optional: bool = False) -> list[NDArray[Any]] | None:
    """The arrays, None without the file, or without the first of them if they are optional."""
    if not path.is_file():
        return None
    try:
        with zipfile.ZipFile(path) as packed, np.load(path) as archive:
            if optional and names[0] not in archive:
                return None
            for name in names:
                _hold_to_size(path, packed, name)
            return [archive[name] for name in names]
    except DataError:
        raise
    except Exception as error:  # numpy evaluates headers, zlib has errors of its own
        raise DataError(f"{path}: not readable: {_line(error)}") from error


def _hold_to_size(path: Path, packed: zipfile.ZipFile, name: str) -> None:
    """Refuse an array whose header promises more than its member of the archive holds."""
    member = packed.getinfo(f"{name}.npy")
    if member.file_size > UNPACKED_TIMES * member.compress_size + UNPACKED_ALWAYS:
        raise DataError(f"{path}: {name} unpacks to {member.file_size} bytes, refused")
    with packed.open(member) as file:
        version = np.lib.format.read_magic(file)
        old = version == (1, 0)
        read = np.lib.format.read_array_header_1_0 if old else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(file)
    if math.prod(shape) * dtype.itemsize > member.file_size:
        raise DataError(f"{path}: {name} {shape} announced, {member.file_size} bytes in the file")


def _line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
