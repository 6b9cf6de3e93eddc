"""The robust descriptor and score against values worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.types import Array
from rbtm_bench.similarity.curvature_circular import CurvatureCircular


def descriptor(u: list[complex] | Array, known: list[int] | Array | None = None) -> Array:
    """What ``describe`` would give for these unit numbers; 0 where not known."""
    u = np.asarray(u, dtype=complex)
    mask = np.ones(len(u)) if known is None else np.asarray(known, dtype=float)
    u = u * mask
    return np.concatenate([u.real, u.imag, mask])


def one(similarity: CurvatureCircular, row: Array, column: Array) -> float:
    return float(similarity.scores(row[None], column)[0])


def turned(phi_deg: list[float]) -> Array:
    return np.exp(2j * np.radians(phi_deg))


def test_u_by_hand(corners) -> None:
    """Slopes 1, 4 and -2: exp(2i atan t) = (1 - t^2 + 2it) / (1 + t^2)."""
    scan = corners([(1, 0), (2, 1), (3, 2), (2.5, 3), (2, 4)])
    got = CurvatureCircular(half_span_deg=15.0).describe(scan)  # beams are 15.9 deg apart: h = 1
    u = [1j, (-15 + 8j) / 17, (-3 - 4j) / 5]
    np.testing.assert_allclose(got, descriptor(u), atol=1e-14)


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize(("half_span_deg", "h"), [(0.1, 1), (1.0, 1), (1.6, 2), (3.0, 3)])
def test_the_half_span_is_in_degrees(beams, half_span_deg, h, sense) -> None:
    """On a circle of evenly spaced beams, sensed either way round, every chord is at a right
    angle to its beam."""
    angles = sense * np.radians(np.arange(-90.0, 91.0))
    got = CurvatureCircular(half_span_deg).describe(beams(np.full(181, 2.0), angles))
    expected = np.exp(2j * (angles[h:-h] + np.pi / 2))
    np.testing.assert_allclose(got, descriptor(expected), atol=1e-12)


def test_a_half_span_of_half_the_scan_is_refused(beams) -> None:
    scan = beams(np.full(5, 2.0), np.radians(np.arange(5.0)))
    with pytest.raises(ConfigError, match=r"half_span_deg=3.0 spans 6 of 5 beams"):
        CurvatureCircular(half_span_deg=3.0).describe(scan)


def test_the_beam_spacing_may_not_change(beams) -> None:
    similarity = CurvatureCircular()
    similarity.describe(beams(np.full(181, 2.0), np.radians(np.arange(181.0))))
    with pytest.raises(DataError, match="beam spacing changes"):
        similarity.describe(beams(np.full(181, 2.0), np.radians(0.5 * np.arange(181.0))))


def test_no_return_and_coincident_points_are_left_out(beams) -> None:
    angles = np.radians(np.arange(0.0, 9.0))
    ranges = np.full(9, 2.0)
    ranges[2] = np.nan
    known = CurvatureCircular(1.0, min_variance=0.0).describe(beams(ranges, angles))[14:]
    np.testing.assert_array_equal(known, [0, 1, 0, 1, 1, 1, 1])  # of beams 1 .. 7
    np.testing.assert_array_equal(
        CurvatureCircular(1.0, min_variance=0.0).describe(beams(np.zeros(9), angles)), np.zeros(21)
    )


def test_the_score_by_hand() -> None:
    """Differences of phi of 0, 0, 45 and 90 deg: the mean of 1, 1, i and -1 is (1 + i) / 4."""
    row, column = descriptor(turned([10, 20, 60, 100])), descriptor(turned([10, 20, 15, 10]))
    assert one(CurvatureCircular(), row, column) == pytest.approx(np.sqrt(2) / 4)
    consistent = CurvatureCircular(lag_phase="consistent")
    assert one(consistent, row, column) == pytest.approx(0.25)


def test_angles_wrap_at_180_deg() -> None:
    """+89.5 and -89.5 deg are walls that differ by one degree."""
    row, column = descriptor(turned([89.5] * 3)), descriptor(turned([-89.5] * 3))
    consistent = CurvatureCircular(lag_phase="consistent")
    assert one(consistent, row, column) == pytest.approx(np.cos(np.radians(2.0)))


def test_the_score_counts_shared_beams_only() -> None:
    row = descriptor(turned([10, 20, 60, 0]), [1, 1, 1, 0])
    column = descriptor(turned([10, 20, 0, 100]), [1, 1, 0, 1])
    assert one(CurvatureCircular(), row, column) == pytest.approx(1.0)


@pytest.mark.parametrize(("share", "defined"), [(0.5, True), (0.51, False), (0.0, True)])
def test_too_few_shared_beams_are_undefined(share, defined) -> None:
    row = descriptor(turned([10, 20, 60, 0]), [1, 1, 1, 0])
    column = descriptor(turned([10, 20, 0, 100]), [1, 1, 0, 1])
    similarity = CurvatureCircular(min_valid_share=share)
    assert np.isnan(one(similarity, row, column)) != defined


def test_nothing_shared_is_undefined() -> None:
    row, column = descriptor([1, 1], [1, 0]), descriptor([1, 1], [0, 1])
    assert np.isnan(one(CurvatureCircular(min_valid_share=0.0), row, column))


@pytest.mark.parametrize("seed", range(10))
def test_center_is_the_complex_correlation_coefficient(seed) -> None:
    rng = np.random.default_rng(seed)
    u, v = (np.exp(2j * rng.normal(scale=0.6, size=50)) for _ in range(2))
    known_u, known_v = (rng.random((2, 50)) < 0.8).astype(float)
    shared = (known_u * known_v) > 0
    a, b = u[shared], v[shared]
    cov = np.mean((a - a.mean()) * np.conj(b - b.mean()))
    expected = cov / np.sqrt(np.mean(abs(a - a.mean()) ** 2) * np.mean(abs(b - b.mean()) ** 2))
    row, column = descriptor(u, known_u), descriptor(v, known_v)
    free = CurvatureCircular(center=True, min_valid_share=0.2)
    assert one(free, row, column) == pytest.approx(abs(expected))
    consistent = CurvatureCircular(center=True, min_valid_share=0.2, lag_phase="consistent")
    assert one(consistent, row, column) == pytest.approx(expected.real)


def test_center_of_equal_angles_is_undefined() -> None:
    row, column = descriptor(turned([30] * 4)), descriptor(turned([10, 20, 60, 0]))
    assert np.isnan(one(CurvatureCircular(center=True), row, column))
    assert np.isnan(one(CurvatureCircular(center=True), row, row))


@pytest.mark.parametrize(("least", "defined"), [(0.79, True), (0.81, False)])
def test_min_variance(corners, least, defined) -> None:
    """Around a corner phi is 0 three times, then -45 and 90 deg: the mean of u is (2 - i) / 5 and
    the variance 1 - 1/5."""
    scan = corners([(0, 4), (1, 4), (2, 4), (3, 4), (4, 4), (4, 3), (4, 2)])
    similarity = CurvatureCircular(half_span_deg=10.0, min_variance=least)  # 10.6 deg: h = 1
    got = similarity.describe(scan)
    assert got.any() == defined
    assert np.isnan(one(similarity, got, got)) != defined


@pytest.mark.parametrize("turn", np.linspace(-0.5, 0.5, 41))
def test_a_perfect_wall_counts_only_with_min_variance_0(beams, turn) -> None:
    """Its variance is zero, or -1e-16 by rounding."""
    angles = np.linspace(-1.0, 1.0, 101)
    wall = beams(1.0 / np.cos(angles - turn), angles)
    anything = CurvatureCircular(min_variance=0.0)
    assert one(anything, anything.describe(wall), anything.describe(wall)) == pytest.approx(1.0)
    assert not CurvatureCircular(min_variance=1e-6).describe(wall).any()
