"""The Hough domain, against votes counted by hand and numpy's own correlations."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from rbtm_bench.backends.hough import (
    cells_for,
    correlate_columns,
    correlate_spectra,
    directions,
    hough_spectrum,
    peaks,
    vote,
)
from rbtm_bench.core.types import Array

UPRIGHT = (1.0, 0.0)
CELL = 0.05


def everywhere(values: Array) -> Array:
    return np.ones(len(values), dtype=bool)


def room(noise: float = 0.0) -> Array:
    """Points (N, 2) m on the walls of an L-shaped room, about their mean."""
    corners = np.array([(0, 0), (6, 0), (6, 2.5), (3.5, 2.5), (3.5, 4), (0, 4), (0, 0)], float)
    walls = [np.linspace(a, b, 80, endpoint=False) for a, b in pairwise(corners)]
    xy = np.concatenate(walls) + noise * np.random.default_rng(0).standard_normal((480, 2))
    return xy - xy.mean(axis=0)


def turned(xy: Array, angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return xy @ np.array([[c, s], [-s, c]])


def reach_of(xy: Array) -> float:
    return float(np.linalg.norm(xy, axis=1).max())


def spectrum(xy: Array, count: int = 180) -> Array:
    return hough_spectrum(xy, np.full(len(xy), 1 / len(xy)), reach_of(xy), CELL, count)


def test_a_point_votes_for_the_lines_through_it() -> None:
    """(1, 2) lies 1 m off along x, 2 m along y, 3 / sqrt 2 along the diagonal."""
    point, weight = np.array([[1.0, 2.0]]), np.array([0.7])
    for angle, rho in ((0.0, 1.0), (np.pi / 2, 2.0), (np.pi / 4, 3 / np.sqrt(2))):
        column = vote(point, weight, UPRIGHT, angle, CELL, 3.0)
        assert len(column) == cells_for(3.0, CELL) == 125
        place = np.arange(125) - 62
        assert column.sum() == pytest.approx(0.7)
        assert (column * place).sum() / 0.7 * CELL == pytest.approx(rho)
        assert np.count_nonzero(column > 1e-12) <= 2


def test_a_vote_is_shared_by_neighbouring_cells() -> None:
    column = vote(np.array([[0.51, 0.0]]), np.ones(1), UPRIGHT, 0.0, 0.1, 1.0)
    middle = len(column) // 2
    assert column[middle + 5] == pytest.approx(0.9)
    assert column[middle + 6] == pytest.approx(0.1)


def test_points_are_turned_before_they_vote() -> None:
    xy = room()
    weights = np.random.default_rng(1).uniform(0.5, 1, len(xy))
    given = vote(xy, weights, (np.cos(0.7), np.sin(0.7)), 0.2, CELL, reach_of(xy))
    np.testing.assert_allclose(
        given, vote(turned(xy, 0.7), weights, UPRIGHT, 0.2, CELL, reach_of(xy))
    )
    same = vote(xy, weights, UPRIGHT, 0.2 - 0.7, CELL, reach_of(xy))  # turning scan or direction
    np.testing.assert_allclose(given, same, atol=1e-9)


def test_columns_hold_points_at_the_edge() -> None:
    xy = np.array([[5.0, 0.0], [-5.0, 0.0]])
    for angle in np.linspace(0, np.pi, 50):
        assert vote(xy, np.ones(2), UPRIGHT, angle, 0.03, 5.0).sum() == pytest.approx(2.0)


@pytest.mark.parametrize("shift", [(0.013, -0.021), (0.4, 1.1), (-2.0, 0.5)])
def test_the_spectrum_does_not_see_translation(shift: tuple[float, float]) -> None:
    xy = room(0.005)
    reach = reach_of(xy) + 3.0
    weights = np.full(len(xy), 1 / len(xy))
    first = hough_spectrum(xy, weights, reach, CELL, 180)
    shifted = hough_spectrum(xy + shift, weights, reach, CELL, 180)
    assert np.abs(first - shifted).max() < 0.1 * first.max()
    assert np.corrcoef(first, shifted)[0, 1] > 0.99


@pytest.mark.parametrize("degrees", [0, 1, 37, 90, 179])
def test_the_spectrum_turns_with_the_scan(degrees: int) -> None:
    xy = room(0.005)
    match = correlate_spectra(spectrum(turned(xy, np.deg2rad(degrees))), spectrum(xy))
    quarter = match[[degrees % 180, (degrees + 90) % 180]]
    assert match.argmax() in (degrees % 180, (degrees + 90) % 180)  # walls at right angles
    assert quarter[0] > 0.9 * match.max()


def test_half_a_turn_leaves_the_spectrum_as_it_is() -> None:
    xy = room(0.005)
    np.testing.assert_allclose(spectrum(turned(xy, np.pi)), spectrum(xy), rtol=1e-9)


def test_walls_are_where_the_spectrum_is_high() -> None:
    """Normals at 0 and 90 deg."""
    high = spectrum(room(0.005))
    bins = peaks(high, True, everywhere(high), 2, 20.0)
    np.testing.assert_allclose(np.sort((bins + 20.0) % 180.0), [20.0, 110.0], atol=1.0)


def test_spectra_correlate_in_a_circle() -> None:
    random = np.random.default_rng(2)
    a, b = random.random((2, 40))
    expected = [np.dot(np.roll(b, s), a) for s in range(40)]
    np.testing.assert_allclose(correlate_spectra(a, b), expected)


@pytest.mark.parametrize(("low", "high"), [(-40, 40), (-5, 12), (3, 3), (20, 90), (-90, -60)])
def test_columns_correlate_as_numpy_says(low: int, high: int) -> None:
    """Both count cells from their middle; whatever lies outside is zero."""
    random = np.random.default_rng(3)
    target, source = random.random(61), random.random(41)
    source[::3] = 0.0
    full = np.correlate(np.pad(target, 200), source, mode="valid")
    zero = 200 + 61 // 2 - 41 // 2
    expected = full[zero + low : zero + high + 1]
    out = np.full(high - low + 1, np.nan)  # to be overwritten
    correlate_columns(target, source, low, out)
    np.testing.assert_allclose(out, expected)


def test_shifted_columns_match_where_they_were_shifted_to() -> None:
    xy = room(0.005)
    weights = np.ones(len(xy))
    shifted = vote(xy + np.array([0.6, 0.0]), weights, UPRIGHT, 0.0, CELL, reach_of(xy) + 1)
    column = vote(xy, weights, UPRIGHT, 0.0, CELL, reach_of(xy))
    match = np.empty(61)
    correlate_columns(shifted, column, -30, match)
    assert match.argmax() - 30 == 12


def test_peaks_come_highest_first_and_apart() -> None:
    values = np.zeros(50)
    values[[10, 12, 20, 40]] = 3.0, 2.9, 1.0, 2.0
    assert peaks(values, False, everywhere(values), 9, 5.0).tolist() == [10, 40, 20]
    assert peaks(values, False, everywhere(values), 9, 1.0).tolist() == [10, 12, 40, 20]
    assert peaks(values, False, everywhere(values), 2, 5.0).tolist() == [10, 40]


def test_peaks_lie_between_bins() -> None:
    place = 17.3
    values = 10.0 - (np.arange(40) - place) ** 2
    values[values < 0] = 0.0
    assert peaks(values, False, everywhere(values), 1, 1.0)[0] == pytest.approx(place)


def test_only_allowed_peaks_count() -> None:
    values = np.zeros(50)
    values[[10, 40]] = 3.0, 2.0
    allowed = np.arange(50) > 20
    assert peaks(values, False, allowed, 5, 1.0).tolist() == [40]
    assert len(peaks(values, False, np.zeros(50, dtype=bool), 5, 1.0)) == 0


def test_a_circle_has_no_end() -> None:
    values = np.zeros(36)
    values[[0, 35, 34, 18]] = 4.0, 3.0, 2.0, 1.0
    around = peaks(values, True, everywhere(values), 5, 5.0)
    assert around[1:].tolist() == [18]
    assert around[0] == pytest.approx(0.5 * (3.0 - 0.0) / (3.0 - 8.0))  # pulled towards bin 35
    in_line = peaks(values, False, everywhere(values), 5, 5.0)
    np.testing.assert_allclose(in_line, [0.0, 34.75, 18.0])


def test_directions_are_strong_in_both_and_not_parallel() -> None:
    source, target = np.full(180, 0.1), np.full(180, 0.1)
    source[[20, 22, 110]] = 9.0, 8.0, 2.0
    target[[50, 52, 140]] = 9.0, 8.0, 2.0  # turned by 30
    chosen = directions(target, source, 30, 3)
    assert chosen[0] == 50
    assert chosen[1] == 140  # not 52, though it is stronger
    assert len(set(chosen.tolist())) == 3
