"""``scores``, ``pairwise``, ``matrix`` and ``band`` are four ways to the same numbers."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rbtm_bench.core.types import Array
from rbtm_bench.similarity.base import Similarity
from rbtm_bench.similarity.curvature import Curvature
from rbtm_bench.similarity.curvature_circular import CurvatureCircular
from rbtm_bench.similarity.range_correlation import RangeCorrelation

ANGLES = np.radians(np.arange(-30.0, 30.0))

SIMILARITIES: list[Similarity] = [
    Curvature(),
    Curvature(min_valid_share=0.0),
    CurvatureCircular(),
    CurvatureCircular(half_span_deg=1.0, max_lag_deg=3.0, lag_phase="consistent"),
    CurvatureCircular(center=True, max_lag_deg=2.0),
    CurvatureCircular(center=True, lag_phase="consistent", min_valid_share=0.8, min_variance=0.3),
    RangeCorrelation(),
    RangeCorrelation(0.0, min_valid_share=0.8),
]


def described(similarity: Similarity, beams, count: int, seed: int) -> Array:
    """Descriptors of scans with random walls and a random share of beams lost."""
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(1.0, 4.0, (count, 1)) + rng.normal(scale=0.2, size=(count, len(ANGLES)))
    lost = rng.random(ranges.shape) < rng.choice([0.0, 0.1, 0.5, 1.0], (count, 1))
    ranges[lost] = np.nan
    return np.stack([similarity.describe(beams(r, ANGLES)) for r in ranges])


@pytest.mark.parametrize("similarity", SIMILARITIES, ids=range(len(SIMILARITIES)))
def test_band_matrix_and_scores_agree(similarity, beams) -> None:
    @settings(deadline=None, max_examples=20)
    @given(
        count=st.integers(1, 20),
        window=st.integers(2, 25),
        block=st.integers(1, 8),
        seed=st.integers(0, 10_000),
    )
    def check(count: int, window: int, block: int, seed: int) -> None:
        descriptors = described(similarity, beams, count, seed)
        matrix = similarity.matrix(descriptors)
        with patch("rbtm_bench.similarity.base.BLOCK", block):
            band = similarity.band(descriptors, window)
        expected = np.full((count, window - 1), np.nan)
        for j in range(count):
            scores = similarity.scores(descriptors, descriptors[j])
            np.testing.assert_allclose(scores, matrix[:, j], rtol=0, atol=1e-12)
            for gap in range(1, min(window - 1, j) + 1):
                expected[j, gap - 1] = matrix[j - gap, j]
        np.testing.assert_allclose(band, expected, rtol=0, atol=1e-12)

    check()


@pytest.mark.parametrize("similarity", SIMILARITIES, ids=range(len(SIMILARITIES)))
def test_scores_are_symmetric_bounded_and_1_with_oneself(similarity, beams) -> None:
    matrix = similarity.matrix(described(similarity, beams, 30, seed=1))
    np.testing.assert_allclose(matrix, matrix.T, rtol=0, atol=1e-12)
    known = matrix[np.isfinite(matrix)]
    assert (np.abs(known) <= 1.0).all() and len(known) > 100
    itself = np.diagonal(matrix)
    np.testing.assert_allclose(itself[np.isfinite(itself)], 1.0, atol=1e-12)
    assert np.isnan(itself).any(), "scans without a return have no score, not even with themselves"


def test_a_band_needs_no_more_than_a_block_at_a_time(beams) -> None:
    """``band`` asks for pairs block by block, and for every pair of the band exactly once."""
    asked: list[int] = []

    class Counting(Curvature):
        def pair_scores(self, rows: Array, columns: Array) -> Array:
            asked.append(len(columns))
            return super().pair_scores(rows, columns)

    descriptors = described(Curvature(), beams, 50, seed=2)
    with patch("rbtm_bench.similarity.base.BLOCK", 16):
        Counting().band(descriptors, window=10)
    assert max(asked) <= 16
    assert sum(asked) == sum(min(j, 9) for j in range(50))


@pytest.mark.parametrize("similarity", SIMILARITIES, ids=range(len(SIMILARITIES)))
def test_band_and_scores_are_the_same_bits(similarity, beams) -> None:
    """A sweep takes scores from the band, a single run computes them: no bit may differ."""
    descriptors = described(similarity, beams, 40, seed=3)
    band = similarity.band(descriptors, window=8)
    for j in range(1, 40):
        past = descriptors[max(0, j - 7) : j]
        alone = similarity.scores(past, descriptors[j])[::-1]
        np.testing.assert_array_equal(band[j, : len(past)], alone)


def test_a_plug_in_needs_scores_only(beams) -> None:
    """The base class makes matrix and band out of ``scores``."""

    class Product(Similarity):
        def describe(self, scan):
            return np.array([float(scan.index)])

        def scores(self, window, descriptor):
            return window[:, 0] * descriptor[0]

    descriptors = np.array([[1.0], [2.0], [3.0]])
    np.testing.assert_array_equal(Product().matrix(descriptors), [[1, 2, 3], [2, 4, 6], [3, 6, 9]])
    nan = np.nan
    np.testing.assert_array_equal(Product().band(descriptors, 3), [[nan, nan], [2, nan], [6, 3]])
