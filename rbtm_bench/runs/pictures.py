"""What pictures of a run need beyond its steps: the map and a similarity matrix."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from rbtm_bench.backends.system import System
from rbtm_bench.core.files import write_atomically
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.odometry.method import Method
from rbtm_bench.similarity.base import Similarity

SIMILARITY_PICTURE = 181
"""Scans at most in the similarity matrix that a run keeps: the paper's Fig. 1(c)."""


def write_pictures(
    dataset: Dataset,
    method: Method | System,
    estimate: Trajectory,
    resolution: float,
    out: Path,
) -> None:
    """The map, as points and as an occupancy grid of what planar scans saw, with cells of
    ``resolution`` m, and a similarity matrix."""
    from rbtm_bench.runs.mapping import build_map

    points = build_map(dataset, estimate.T_world_scan, resolution)
    grid: dict[str, Any] = {}
    if dataset.planar:  # in space a beam seen from above crosses walls that it passes over
        from rbtm_bench.runs.occupancy import build_grid

        grid = build_grid(dataset, estimate.T_world_scan, points, resolution).arrays()
    write_npz(out / "map.npz", points=points, **grid)
    if isinstance(method, System) or not method.selector.needs_scores:
        return
    scans, scores = similarity_matrix(dataset, method.similarity)
    write_npz(out / "similarity.npz", scans=scans, scores=scores)


def similarity_matrix(dataset: Dataset, similarity: Similarity) -> tuple[Any, Array]:
    """Scan numbers (K,) and scores (K, K) of at most 181 scans spread over the data set."""
    count = min(len(dataset), SIMILARITY_PICTURE)
    scans = np.unique(np.linspace(0, len(dataset) - 1, count).round().astype(np.int64))
    descriptors = np.stack([similarity.describe(dataset[int(i)].without_truth()) for i in scans])
    return scans, similarity.matrix(descriptors)


def write_npz(path: Path, **arrays: Any) -> None:
    """A compressed numpy archive."""

    def write(partial: Path) -> None:
        with open(partial, "wb") as file:
            np.savez_compressed(file, **arrays)

    write_atomically(path, write)
