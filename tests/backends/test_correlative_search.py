"""Branch and bound gives what an exhaustive search gives, ties included."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rbtm_bench.backends.correlative_search import (
    MOST_POINTS,
    Window,
    search,
    thinned,
    turns_of,
)
from rbtm_bench.backends.likelihood_field import BITS, Field, field_of, with_widest
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.types import Array


def scores_of_all(points: Array, field: Field, window: Window) -> np.ndarray:
    """The sums (K, S, S) of every pose, one after the other, by rotation, row and column."""
    cells = field.levels[0][0, 0].astype(np.int64)
    side = 2 * window.cells + 1
    out = np.zeros((len(window.turns), side, side), np.int64)
    for k, turn in enumerate(window.turns):
        c, s = math.cos(window.theta + turn), math.sin(window.theta + turn)
        for x, y in points:
            px = c * x - s * y + window.x - field.corner[0]
            py = s * x + c * y + window.y - field.corner[1]
            columns = math.floor(px / field.size) - window.cells + np.arange(side)
            rows = math.floor(py / field.size) - window.cells + np.arange(side)
            i = (columns >= 0) & (columns < cells.shape[1])
            j = (rows >= 0) & (rows < cells.shape[0])
            out[k][np.ix_(j, i)] += cells[np.ix_(rows[j], columns[i])]
    return out


def first_of_best(scores: np.ndarray, window: Window) -> tuple[int, int, int]:
    """Of the highest scores that with the least turn, then the least shift, then the first."""
    best = np.argwhere(scores == scores.max())
    middle, m = len(window.turns) // 2, window.cells
    k, j, i = min(
        best.tolist(),
        key=lambda p: (abs(p[0] - middle), (p[1] - m) ** 2 + (p[2] - m) ** 2, p),
    )
    return k, j, i


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    count=st.sampled_from([1, 2, 3, 40]),  # few points: many equal scores
    cells=st.sampled_from([0, 3, 9, 17]),
    around=st.booleans(),
    far=st.booleans(),
)
def test_the_best_pose_is_that_of_an_exhaustive_search(
    seed: int, count: int, cells: int, around: bool, far: bool
) -> None:
    rng = np.random.default_rng(seed)
    target = rng.uniform(-1.5, 1.5, (30, 3))
    points = rng.uniform(-1.5, 1.5, (count, 2))
    field = field_of(target, 0.1, float(rng.uniform(0.03, 0.2)))
    assert field is not None
    turns = turns_of(points, 0.3, math.pi) if around else np.linspace(-0.3, 0.3, 7)
    x, y, theta = rng.uniform(-0.5, 0.5, 3) + (2.0 if far else 0.0)  # partly beyond the field
    window = Window(x, y, theta, cells, turns)
    apart, apart_turn = 0.25, 0.35
    peak = search(points, field, window, apart, apart_turn)
    scores = scores_of_all(points, field, window)
    k, j, i = first_of_best(scores, window)
    pose = [x + (i - cells) * field.size, y + (j - cells) * field.size, theta + turns[k]]
    np.testing.assert_allclose(peak.pose, pose, atol=1e-12)
    assert peak.score == scores.max() / (255 * count)
    assert peak.middle_score == scores[len(turns) // 2, cells, cells] / (255 * count)
    away = np.abs(np.arange(len(turns)) - k)
    away = np.minimum(away, len(turns) - away)
    inside = np.abs(np.arange(2 * cells + 1)[:, None] - [j, i]) <= math.ceil(apart / field.size)
    step = turns[1] - turns[0]
    zone = (away <= math.ceil(apart_turn / step))[:, None, None]
    zone = zone & inside[:, 0][:, None] & inside[:, 1]
    others = scores[~zone]
    second = others.max() if others.size else 0
    assert scores.max() == 0 or peak.peak_ratio == pytest.approx(second / scores.max())


def test_values_of_the_field_are_likelihoods_and_blocks_their_maxima() -> None:
    points = np.random.default_rng(3).uniform(-2.0, 2.0, (25, 3))
    field = field_of(points, 0.1, 0.15)
    assert field is not None
    cells = field.levels[0][0, 0]
    y, x = np.indices(cells.shape) + 0.5
    middles = np.stack([x, y], axis=-1) * field.size + field.corner
    d = np.linalg.norm(middles[:, :, None] - points[:, :2], axis=-1).min(axis=-1)
    likelihood = np.where(d < 0.4, np.exp(-0.5 * (d / 0.15) ** 2), 0.0)
    near = d < 0.4
    np.testing.assert_allclose(cells[near] / 255, likelihood[near], atol=0.5 / 255 + 1e-9)
    assert with_widest(field).levels[0] is field.levels[0] and not field.levels[2].size
    for level, bits in zip(with_widest(field).levels, BITS, strict=True):
        s = 1 << bits
        for row, column in ((0, 0), (3, 5), (17, 20), (cells.shape[0] - 1, 30)):
            block = cells[row : row + s, column : column + s].max()
            assert level[row % s, column % s, row // s, column // s] == block


def test_points_are_thinned_along_the_scan_and_no_more_than_fit() -> None:
    line = np.column_stack([np.arange(0.0, 1.0, 0.01), np.zeros(100), np.zeros(100)])
    gaps = np.diff(thinned(line, 0.05)[:, 0])
    assert (gaps >= 0.05).all() and (gaps < 0.0701).all()
    assert len(thinned(np.repeat(line, 5, axis=0), 0.0)) == MOST_POINTS


@pytest.mark.parametrize("most", [0.01, 0.5, math.pi])
def test_rotations_hold_none_and_move_points_by_no_more_than_a_cell(most: float) -> None:
    points = np.array([[3.0, 0.0], [0.0, 5.0]])
    turns = turns_of(points, 0.05, most)
    lever = math.sqrt(17.0)
    assert turns[len(turns) // 2] == 0.0
    assert np.diff(turns).max() * lever <= 0.05 + 1e-9
    if most < math.pi:
        assert turns[-1] == -turns[0] == pytest.approx(most)
    else:  # each once
        assert np.ptp(turns) + turns[1] - turns[0] == pytest.approx(2 * math.pi)


def test_a_window_or_target_that_fits_no_memory_is_refused() -> None:
    points = np.zeros((6, 3))
    field = field_of(points, 0.05, 0.1)
    assert field is not None
    with pytest.raises(BackendError, match=r"200001 x 200001 shifts and 1 rotations"):
        search(points[:, :2].copy(), field, Window(0, 0, 0, 100_000, np.zeros(1)), 0.0, 0.0)
    points[0] = 1e6
    assert field_of(points, 0.05, 0.1) is None
