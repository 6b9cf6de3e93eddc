"""The map of a trajectory: every scan at its pose, one point a cell, little memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rbtm_bench.core.geometry import se2
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.runs import mapping
from rbtm_bench.runs.mapping import build_map


class Clouds(Dataset):
    """Scans made of given points."""

    def __init__(self, clouds: list[Any]) -> None:
        self.clouds = [np.asarray(cloud, dtype=float).reshape(-1, 3) for cloud in clouds]

    def __len__(self) -> int:
        return len(self.clouds)

    def __getitem__(self, index: int) -> Scan:
        return Scan(index, 0.1 * index, self.clouds[index])

    def fingerprint(self) -> str:
        return "by hand"


def still(count: int) -> Array:
    return np.tile(np.eye(4), (count, 1, 1))


def test_points_are_placed_by_their_scans_pose() -> None:
    clouds = Clouds([[[1, 0, 0.5]], [[1, 0, 0.5]]])
    poses = np.stack([np.eye(4), se2(10, 0, np.pi / 2)])
    assert build_map(clouds, poses, 0.1).tolist() == [[1, 0, 0.5], [10, 1, 0.5]]


def test_one_point_a_cell_the_first_seen() -> None:
    clouds = Clouds([[[0.01, 0, 0], [0.51, 0, 0]], [[0.09, 0.09, 0.09], [-0.01, 0, 0]]])
    points = build_map(clouds, still(2), 0.1)
    assert points == pytest.approx(np.array([[0.01, 0, 0], [0.51, 0, 0], [-0.01, 0, 0]]))
    assert points.dtype == np.float32


def test_coarser_cells_keep_fewer_points() -> None:
    corridor = Corridor(scans=10)
    sizes = [len(build_map(corridor, corridor.ground_truth, r)) for r in (0.01, 0.05, 0.5)]
    assert sizes[0] > 2 * sizes[1] > 4 * sizes[2] > 0


def test_thinning_in_batches_gives_the_same_map(monkeypatch: pytest.MonkeyPatch) -> None:
    corridor = Corridor(scans=12)
    whole = build_map(corridor, corridor.ground_truth, 0.05)
    monkeypatch.setattr(mapping, "BATCH", 1000)
    assert np.array_equal(build_map(corridor, corridor.ground_truth, 0.05), whole)


def test_true_poses_make_thin_walls_and_wrong_ones_do_not() -> None:
    corridor = Corridor(scans=30, range_noise=0.0)
    true = build_map(corridor, corridor.ground_truth, 0.05)
    stuck = build_map(corridor, still(30), 0.05)
    assert len(stuck) > 1.2 * len(true)  # the recesses are smeared along the corridor


def test_scans_without_a_point() -> None:
    assert build_map(Clouds([[], []]), still(2), 0.1).shape == (0, 3)
    assert build_map(Clouds([[], [[1, 2, 3]], []]), still(3), 0.1).tolist() == [[1, 2, 3]]


def test_poses_must_be_as_many_as_scans() -> None:
    with pytest.raises(ValueError):
        build_map(Clouds([[[1, 2, 3]]]), still(2), 0.1)
