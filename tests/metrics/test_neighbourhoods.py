"""Scatter and cells of points: by hand, and against going through all pairs."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.metrics.neighbourhoods import occupied_cells, scatter


def brute_force(points, centres, radius):
    number, covariance = [], []
    for centre in points[centres]:
        near = points[((points - centre) ** 2).sum(axis=1) <= radius**2]
        number.append(len(near))
        covariance.append(np.cov(near.T, bias=True) if len(near) > 1 else 0 * np.cov(points.T))
    return np.array(number), np.array(covariance)


def test_scatter_by_hand():
    points = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1], [5.0, 5.0]])
    number, covariance = scatter(points, np.array([1, 3]), 0.3)
    assert number.tolist() == [3, 1]
    assert covariance[0] == pytest.approx(np.array([[2, -1], [-1, 2]]) / 900)
    assert covariance[1] == pytest.approx(np.zeros((2, 2)))


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("size", [0.1, 3.0, 40.0])
def test_scatter_agrees_with_all_pairs(dimensions, size):
    rng = np.random.default_rng(int(size))
    points = rng.uniform(-size, size, (800, dimensions))
    points[:200] *= 0.05  # dense
    points[200:260, 0] += 1e7  # and a part that flew far away
    points[260:300] = points[260:300].round()  # on the borders of cells
    centres = rng.permutation(800)[:300]
    number, covariance = scatter(points, centres, 0.5)
    wanted, expected = brute_force(points, centres, 0.5)
    assert np.array_equal(number, wanted)
    assert covariance == pytest.approx(expected, abs=1e-9)


def test_a_map_that_flew_apart_stays_countable():
    """As many cells along each axis as points, far beyond the 2^63 of a plain grid."""
    points = np.outer(np.arange(1, 2001.0), [1e9, -1e9, 1e9])
    assert occupied_cells(points, 0.05) == 2000
    number, _ = scatter(points, np.arange(2000), 0.3)
    assert set(number) == {1}


def test_cells_by_hand():
    points = [[0.01, 0.01], [0.04, 0.049], [0.051, 0.01], [-0.01, 0.01], [0.01, 0.2]]
    assert occupied_cells(np.array(points), 0.05) == 4
    above = np.array([[*p, 0.0] for p in points] + [[0.01, 0.01, 0.06]])
    assert occupied_cells(above, 0.05) == 5
    assert occupied_cells(np.array(points), 10.0) == 2  # either side of x = 0


@pytest.mark.parametrize("dimensions", [2, 3])
def test_cells_agree_with_numpy(dimensions):
    points = np.random.default_rng(1).uniform(-2, 2, (5000, dimensions))
    expected = len(np.unique(np.floor(points / 0.05), axis=0))
    assert occupied_cells(points, 0.05) == expected
