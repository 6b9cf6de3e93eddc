"""Areas under ROC curves: by hand, against scipy, within strata, by resampled blocks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import mannwhitneyu

from rbtm_bench.calibration.roc import area, percentiles, ranks_within, resampled


def test_by_hand() -> None:
    # successes 3, 1; failures 2, 1: 3 beats both, 1 loses to 2 and ties with 1: (2 + 0 + 0.5) / 4
    ours = area([3, 1, 2, 1], [True, True, False, False], [0, 1, 2, 3])
    assert ours.value == 0.625
    assert (ours.successes, ours.failures, ours.couples, ours.blocks) == (2, 2, 4, 4)


def test_an_undefined_score_is_the_lowest() -> None:
    assert area([np.nan, 0.0], [True, False], [0, 1]).value == 0.0
    assert area([-0.9, np.nan], [True, False], [0, 1]).value == 1.0
    assert area([np.nan, np.nan], [True, False], [0, 1]).value == 0.5


def test_at_equal_gap_only_couples_of_one_stratum_count() -> None:
    # between the strata the score is perfect, within each it is upside down
    scores, good = [10.0, 11.0, 1.0, 2.0], [True, False, True, False]
    assert area(scores, good, [0, 1, 2, 3]).value == pytest.approx(0.25)
    within = area(scores, good, [0, 1, 2, 3], strata=[0, 0, 1, 1])
    assert (within.value, within.couples) == (0.0, 2)


def test_nothing_to_compare() -> None:
    ours = area([1.0, 2.0], [True, True], [0, 1])
    assert np.isnan(ours.value) and ours.low is None and ours.couples == 0
    apart = area([1.0, 2.0], [True, False], [0, 1], strata=[0, 1])
    assert np.isnan(apart.value)
    assert np.isnan(area([], [], []).value)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_as_mann_and_whitney(seed: int) -> None:
    random = np.random.default_rng(seed)
    scores = random.integers(0, 6, 40).astype(float)
    good = random.random(40) < 0.5
    good[:2] = True, False
    u = mannwhitneyu(scores[good], scores[~good]).statistic
    ours = area(scores, good, np.arange(40))
    assert ours.value == pytest.approx(u / (good.sum() * (~good).sum()))
    assert area(-scores, good, np.arange(40)).value == pytest.approx(1 - ours.value)


def test_blocks_that_repeat_themselves_are_no_more_information() -> None:
    random = np.random.default_rng(1)
    scores, good = random.normal(size=60), random.random(60) < 0.5
    scores += good
    single = area(scores, good, np.arange(60))
    many = area(np.repeat(scores, 5), np.repeat(good, 5), np.repeat(np.arange(60), 5))
    assert many.value == pytest.approx(single.value)
    assert (many.low, many.high) == pytest.approx((single.low, single.high))
    naive = area(np.repeat(scores, 5), np.repeat(good, 5), np.arange(300))
    assert naive.low is not None and single.low is not None
    assert naive.low > single.low  # what resampling pairs would make one believe


def test_difference_of_two_scores_of_the_same_pairs() -> None:
    random = np.random.default_rng(2)
    good = random.random(200) < 0.5
    scores = random.normal(size=200) + good
    one, blocks = area(scores, good, np.arange(200) // 4), np.arange(200) // 4
    assert one.minus(area(scores, good, blocks)) == (0.0, 0.0, 0.0)
    value, low, high = one.minus(area(random.normal(size=200), good, blocks))
    assert low is not None and high is not None and 0 < low < value < high


def test_few_blocks_have_no_interval() -> None:
    ours = area([1.0, 0.0, 2.0, 1.0], [True, False, True, False], [0, 0, 1, 1])
    assert ours.value == 0.875 and ours.low is None
    assert percentiles(np.full(10, np.nan)) == (None, None)


def test_resamples_repeat_and_keep_their_number() -> None:
    times = resampled(7)
    np.testing.assert_array_equal(times, resampled(7))
    assert set(times.sum(axis=1)) == {7.0}


def test_ranks_within_a_gap() -> None:
    ranks = ranks_within([5.0, 1.0, 3.0, np.nan, 9.0, 9.0], [1, 1, 1, 1, 2, 2])
    np.testing.assert_allclose(ranks, [5 / 6, 1 / 6, 3 / 6, np.nan, 0.5, 0.5])
