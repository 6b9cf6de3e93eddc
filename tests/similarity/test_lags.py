"""Lags: a turned sensor sees the same place some beams later."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.similarity.curvature_circular import CurvatureCircular

ANGLES = np.radians(np.arange(-90.0, 91.0))

TURNS = [-25, -7, 0, 1, 7, 25]


@pytest.fixture
def turned_by(beams, room):
    """What a sensor sees that stands in the room turned by so many deg (one deg a beam)."""

    def scan(turn_deg: float, sense: int = 1):
        angles = ANGLES[::sense].copy()
        return beams(room(angles + np.radians(turn_deg)), angles)

    return scan


def score(similarity: CurvatureCircular, model, scan) -> float:
    return float(similarity.scores(similarity.describe(model)[None], similarity.describe(scan))[0])


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("phase", ["free", "consistent"])
@pytest.mark.parametrize("turn", TURNS)
def test_a_pure_rotation_is_found(turned_by, turn, phase, sense) -> None:
    similarity = CurvatureCircular(max_lag_deg=30.0, lag_phase=phase)
    best = score(similarity, turned_by(0, sense), turned_by(turn, sense))
    assert best == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("phase", ["free", "consistent"])
@pytest.mark.parametrize("turn", [-25, -7, 7, 25])
def test_it_is_missed_without_lags_or_with_too_few(turned_by, turn, phase) -> None:
    for most in (0.0, abs(turn) - 4.0):
        similarity = CurvatureCircular(max_lag_deg=most, lag_phase=phase)
        assert score(similarity, turned_by(0), turned_by(turn)) < 0.97


@pytest.mark.parametrize("center", [False, True])
@pytest.mark.parametrize("phase", ["free", "consistent"])
def test_the_order_of_the_two_scans_does_not_matter(turned_by, phase, center) -> None:
    similarity = CurvatureCircular(max_lag_deg=20.0, lag_phase=phase, center=center)
    one, other = turned_by(0), turned_by(13)
    assert score(similarity, one, other) == pytest.approx(score(similarity, other, one))


@pytest.mark.parametrize("phase", ["free", "consistent"])
def test_more_lags_never_lower_the_score(turned_by, phase) -> None:
    scores = [
        score(CurvatureCircular(max_lag_deg=most, lag_phase=phase), turned_by(0), turned_by(18))
        for most in (0.0, 5.0, 10.0, 20.0, 40.0)
    ]
    assert scores == sorted(scores)


def test_lags_use_up_shared_beams(turned_by) -> None:
    """175 values at the default half-span; a lag of 25 leaves 150 in common, 86 % of them."""
    for share, defined in ((0.85, True), (0.87, False)):
        similarity = CurvatureCircular(max_lag_deg=25.0, min_valid_share=share)
        assert (score(similarity, turned_by(0), turned_by(25)) > 0.999) == defined


def test_lags_beyond_the_scan_change_nothing(turned_by) -> None:
    wide, wider = (CurvatureCircular(max_lag_deg=m, min_valid_share=0.0) for m in (174.0, 180.0))
    assert score(wide, turned_by(0), turned_by(9)) == score(wider, turned_by(0), turned_by(9))


@pytest.mark.parametrize("turn_deg", [20, 50, 80])
def test_a_wall_turned_by_an_arbitrary_angle(beams, turn_deg) -> None:
    """Two straight walls, the one turned. Free phase forgives any turn; a consistent one allows
    only what its lags explain: cos(2 (turn - lag)), 10 deg of lag at most."""

    def wall(turn: float):
        ranges = 2.0 / np.cos(ANGLES - np.radians(turn))
        return beams(np.where((ranges > 0) & (ranges < 30), ranges, np.nan), ANGLES)

    def compare(phase, most: float) -> float:
        similarity = CurvatureCircular(
            max_lag_deg=most, lag_phase=phase, min_variance=0.0, min_valid_share=0.3
        )
        return score(similarity, wall(0), wall(turn_deg))

    assert compare("free", 10.0) == pytest.approx(1.0)
    assert compare("consistent", 10.0) == pytest.approx(np.cos(np.radians(2 * (turn_deg - 10))))
    assert compare("consistent", 0.0) == pytest.approx(np.cos(np.radians(2 * turn_deg)))
    assert compare("consistent", turn_deg) == pytest.approx(1.0)  # a turned sensor looks the same
