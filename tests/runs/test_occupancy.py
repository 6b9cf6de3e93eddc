"""The occupancy grid: cells counted by hand, once a scan, and what runs keep of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rbtm_bench.core.geometry import se2
from rbtm_bench.core.types import Scan
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.runs import occupancy
from rbtm_bench.runs.mapping import build_map
from rbtm_bench.runs.occupancy import Occupancy, build_grid


class Beams(Dataset):
    """Planar scans made of given points."""

    planar = True

    def __init__(self, scans: list[Any]) -> None:
        self.scans = [np.asarray(points, dtype=float).reshape(-1, 2) for points in scans]

    def __len__(self) -> int:
        return len(self.scans)

    def __getitem__(self, index: int) -> Scan:
        points = np.column_stack([self.scans[index], np.zeros(len(self.scans[index]))])
        return Scan(index, 0.1 * index, points, planar=True)

    def fingerprint(self) -> str:
        return "by hand"


def grid(scans: list[Any], *poses: tuple[float, float, float], cell: float = 1.0) -> Occupancy:
    """The grid of scans at poses (x, y, heading), at the origin by default."""
    dataset = Beams(scans)
    T = np.stack([se2(*pose) for pose in poses or [(0.5, 0.5, 0.0)] * len(scans)])
    return build_grid(dataset, T, build_map(dataset, T, cell), cell)


def at(grid: Occupancy, x: float, y: float) -> tuple[int, int]:
    """Hits and passed of the cell that holds a place."""
    column, row = np.floor((np.array([x, y]) - grid.corner) / grid.cell).astype(int)
    return int(grid.hits[row, column]), int(grid.passed[row, column])


def test_a_beam_passes_every_cell_before_its_point() -> None:
    found = grid([[[3.0, 0.0]]])  # from (0.5, 0.5) to (3.5, 0.5)
    assert [at(found, x + 0.5, 0.5) for x in range(4)] == [(0, 1), (0, 1), (0, 1), (1, 0)]
    assert found.hits.sum() == 1 and found.passed.sum() == 3
    assert at(found, -0.5, 0.5) == (0, 0) and at(found, 4.5, 0.5) == (0, 0)


def test_a_slanted_beam_crosses_the_cells_that_it_touches() -> None:
    found = grid([[[2.0, 1.0]]])  # to (2.5, 1.5): up at x = 1.5
    assert [at(found, *place) for place in [(0, 0), (1, 0), (1, 1), (2, 1)]] == [
        (0, 1), (0, 1), (0, 1), (1, 0)
    ]  # fmt: skip
    assert found.passed.sum() == 3
    for x, y in [(-2.0, -1.0), (-1.0, 2.0), (0.3, -2.6), (-3.2, 0.9)]:
        back = grid([[[x, y]]])
        ends = np.abs(np.floor([0.5 + x, 0.5 + y])).sum()  # a border a step
        assert (back.hits.sum(), back.passed.sum()) == (1, ends)


def test_poses_turn_and_shift_the_beams() -> None:
    found = grid([[[3.0, 0.0]]], (5.5, 2.5, np.pi / 2))
    assert [at(found, 5.5, y + 0.5) for y in range(2, 6)] == [(0, 1), (0, 1), (0, 1), (1, 0)]


def test_a_cell_counts_once_a_scan_and_a_point_before_a_beam() -> None:
    twice = [[3.0, 0.0], [3.2, 0.0], [3.0, 0.1]]
    behind = [[3.0, 0.0], [5.0, 0.0]]  # the second beam passes where the first one ends
    found = grid([twice, behind, [[5.0, 0.0]]])
    assert at(found, 3.5, 0.5) == (2, 1)
    assert at(found, 1.5, 0.5) == (0, 3)
    assert at(found, 5.5, 0.5) == (2, 0)
    column, row = np.floor((np.array([3.5, 0.5]) - found.corner) / found.cell).astype(int)
    assert found.share[row, column] == pytest.approx(2 / 3)
    assert np.isnan(found.share[0, 0])


def test_scans_without_points_say_nothing() -> None:
    found = grid([[], []])
    assert found.hits.sum() == found.passed.sum() == 0
    assert np.isnan(found.share).all()


def test_a_large_map_gets_wider_cells_and_keeps_all_poses(monkeypatch: Any) -> None:
    monkeypatch.setattr(occupancy, "CELLS", 500)
    scans, poses = [[[2.0, 0.0]]] * 2, [(0.0, 0.0, 0.0), (90.0, 40.0, 0.0)]
    found = grid(scans, *poses)
    assert found.cell == 4.0 and found.hits.size <= 500
    assert sum(at(found, 90.0, 40.0)) == sum(at(found, 0.0, 0.0)) == 1


def test_stray_points_do_not_widen_the_grid() -> None:
    wall = np.column_stack([np.full(2000, 4.0), np.linspace(-3, 3, 2000)])
    wall[7] = 4000.0, 0.0
    found = grid([wall], (0.0, 0.0, 0.0), cell=0.01)
    assert found.cell == 0.01
    assert max(found.hits.shape) * found.cell < 10.0


def test_the_corridor_is_free_inside_and_its_walls_are_occupied() -> None:
    corridor = Corridor(scans=20, range_noise=0.0)
    points = build_map(corridor, corridor.ground_truth, 0.05)
    found = build_grid(corridor, corridor.ground_truth, points, 0.05)
    for x in (0.5, 1.0, 2.0):
        hits, passed = at(found, x, 0.3)
        assert hits == 0 and passed > 5
    hits, passed = at(found, 2.3, 1.01)  # the wall y = 1 between recesses
    assert hits > 3 * passed
    still = np.tile(np.eye(4), (20, 1, 1))
    smeared = build_grid(corridor, still, build_map(corridor, still, 0.05), 0.05)
    sharp, blurred = (np.nanmean(g.share[g.hits > 0]) for g in (found, smeared))
    assert sharp > 1.5 * blurred


def test_kept_arrays_are_small_and_come_back() -> None:
    found = grid([[[3.0, 0.0]]] * 300, *[(0.5, 0.5, 0.0)] * 300)
    kept = found.arrays()
    assert kept["passed"].dtype == np.uint16 and kept["hits"].dtype == np.uint16
    assert kept["hits"].max() == 300 and float(kept["cell"]) == 1.0
    assert grid([[]]).arrays()["hits"].dtype == np.uint8
