"""The paper's descriptor and score, equations (1) to (3), against values worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.similarity.curvature import Curvature

NAN = float("nan")


def one(similarity: Curvature, row: list[float], column: list[float]) -> float:
    return float(similarity.scores(np.array([row]), np.array(column))[0])


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ([(-1, 1), (0, 1), (1, 1), (2, 1)], [0, 0]),  # a wall along x
        ([(1, 0), (2, 1), (3, 2), (4, 3)], [np.pi / 4, np.pi / 4]),  # a wall at 45 deg
        ([(4, 3), (3, 2), (2, 1)], [np.pi / 4]),  # sensed the other way round: atan, not atan2
        # around a corner: slopes (2-0)/(3-1), (3-1)/(2.5-2), (4-2)/(2-3)
        (
            [(1, 0), (2, 1), (3, 2), (2.5, 3), (2, 4)],
            [np.pi / 4, np.arctan(4.0), np.arctan(-2.0)],
        ),
        ([(1, 1), (2, 2), (1, 1)], [NAN]),  # both neighbours are one point
    ],
)
def test_phi_by_hand(corners, points, expected) -> None:
    np.testing.assert_allclose(Curvature().describe(corners(points)), expected, atol=1e-15)


@pytest.mark.parametrize(("sign", "expected"), [(1, np.pi / 2), (-1, -np.pi / 2)])
def test_dx_zero_takes_the_sign_of_dy(beams, sign, expected) -> None:
    """cos(a) and cos(-a) are equal to the last bit, and so is x."""
    scan = beams(np.array([2.0, 1.9, 2.0]), sign * np.array([-0.4, 0.0, 0.4]))
    np.testing.assert_array_equal(Curvature().describe(scan), [expected])


@pytest.mark.parametrize("count", [3, 4, 181, 681])
def test_n_beams_give_n_minus_2_values(beams, count) -> None:
    scan = beams(np.full(count, 2.0), np.linspace(-1, 1, count))
    assert Curvature().describe(scan).shape == (count - 2,)


def test_a_beam_without_return_takes_away_its_neighbours_values_only(corners) -> None:
    full = [(x, 1 + 0.1 * x * x) for x in (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0)]
    holed = [*full[:3], None, *full[4:]]
    expected = Curvature().describe(corners(full))
    expected[[1, 3]] = NAN  # values 0 .. 4 belong to beams 1 .. 5; beam 3 is missing
    np.testing.assert_allclose(Curvature().describe(corners(holed)), expected, atol=1e-12)


def test_the_score_by_hand() -> None:
    """Deviations (-1, 0, 1) and (-1, 1, 0): Cov = 1/3, both Var = 2/3."""
    assert one(Curvature(), [0.1, 1.1, 2.1], [0.0, 0.2, 0.1]) == pytest.approx(0.5)
    assert one(Curvature(), [0.1, 1.1, 2.1], [2.0, 1.0, 0.0]) == pytest.approx(-1.0)


@pytest.mark.parametrize("seed", range(20))
def test_the_score_is_corrcoef_over_shared_beams(seed) -> None:
    rng = np.random.default_rng(seed)
    window = rng.uniform(-np.pi / 2, np.pi / 2, (6, 60))
    phi = window[2] + rng.normal(scale=0.5, size=60)
    window[rng.random(window.shape) < 0.2] = NAN
    phi[rng.random(60) < 0.2] = NAN
    scores = Curvature().scores(window, phi)
    for row, score in zip(window, scores, strict=True):
        shared = np.isfinite(row) & np.isfinite(phi)
        assert score == pytest.approx(np.corrcoef(row[shared], phi[shared])[0, 1], abs=1e-12)


def test_no_variance_is_undefined() -> None:
    varied, flat = [0.1, 0.2, 0.4, 0.3], [0.7] * 4
    assert np.isnan(one(Curvature(), flat, varied))
    assert np.isnan(one(Curvature(), varied, flat))
    assert np.isnan(one(Curvature(), flat, flat))


def test_no_variance_over_the_shared_beams_is_undefined() -> None:
    """The only value that differs has no partner."""
    assert np.isnan(one(Curvature(), [0.7, 0.7, 0.7, 0.1], [0.1, 0.2, 0.4, NAN]))


@pytest.mark.parametrize(("share", "defined"), [(0.5, True), (0.51, False), (0.0, True)])
def test_too_few_shared_beams_are_undefined(share, defined) -> None:
    """Two of four values are shared: exactly half is enough."""
    row, column = [0.1, 0.2, NAN, 0.5], [0.3, 0.5, 0.1, NAN]
    assert np.isnan(one(Curvature(share), row, column)) != defined


def test_one_shared_beam_is_never_enough() -> None:
    assert np.isnan(one(Curvature(0.0), [0.1, NAN, NAN], [0.3, 0.2, 0.1]))
    assert np.isnan(one(Curvature(0.0), [NAN] * 3, [NAN] * 3))


def test_the_angle_does_not_wrap(beams) -> None:
    """A wall straight ahead, turned by +0.5 and -0.5 deg: the same place, phi on both sides of
    the jump at 90 deg, and the literal score calls the two opposite."""
    angles = np.radians(np.linspace(-60, 60, 121))
    half_ahead = np.abs(angles) < np.radians(30)

    def seen(turn: float) -> np.ndarray:
        ahead = 2.0 / np.cos(angles - np.radians(turn))
        sides = 1.2 / np.abs(np.sin(angles) + 1e-9)
        return Curvature().describe(beams(np.where(half_ahead, ahead, sides), angles))

    left, right = seen(0.5), seen(-0.5)
    assert Curvature().scores(left[None], left)[0] == pytest.approx(1.0)
    assert Curvature().scores(left[None], right)[0] < -0.5
