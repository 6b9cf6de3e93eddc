"""Success rates with their intervals, bins and error quantiles."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binomtest

from rbtm_bench.calibration.rates import bins_of, quantiles, rate, wilson


def test_wilson_as_scipy() -> None:
    bounds = wilson(0.8, 25)
    expected = binomtest(20, 25).proportion_ci(method="wilson")
    assert bounds == pytest.approx((expected.low, expected.high))


def test_independent_pairs_count_as_they_are() -> None:
    # blocks of one pair: variance n/(n-1) p(1-p)/n, hence n - 1 effective pairs
    share = rate([True] * 15 + [False] * 5, np.arange(20))
    assert (share.value, share.n, share.blocks) == (0.75, 20, 20)
    assert share.effective == pytest.approx(19.0)
    assert (share.low, share.high) == pytest.approx(wilson(0.75, 19.0))


def test_blocks_that_agree_count_as_one_pair_each() -> None:
    success, blocks = np.repeat([True, True, True, False], 10), np.repeat(np.arange(4), 10)
    share = rate(success, blocks)
    assert (share.value, share.effective) == (0.75, pytest.approx(3.0))
    assert share.high - share.low > 2 * np.diff(wilson(0.75, 40))[0]


def test_all_alike_cannot_count_more_than_the_blocks() -> None:
    share = rate([True] * 30, np.arange(30) // 10)
    assert (share.value, share.effective) == (1.0, 3.0)
    assert share.low == pytest.approx(wilson(1.0, 3.0)[0]) and share.high == 1.0


def test_nothing() -> None:
    share = rate([], [])
    assert np.isnan(share.value) and (share.low, share.high, share.n) == (0.0, 1.0, 0)


def test_bins_hold_equally_many_and_all() -> None:
    scores = np.array([*np.linspace(0, 1, 80), np.nan])
    bins = list(bins_of(scores, 8))
    assert [len(members) for _, _, members in bins] == [10] * 8
    assert sorted(np.concatenate([m for *_, m in bins])) == list(range(80))
    assert bins[0][0] == 0.0 and bins[-1][1] == 1.0


def test_bins_of_equal_scores() -> None:
    ((low, high, members),) = bins_of(np.ones(12), 8)
    assert (low, high, len(members)) == (1.0, 1.0, 12)
    assert list(bins_of(np.full(3, np.nan), 8)) == []
    mostly = np.concatenate([np.ones(90), np.linspace(0, 0.9, 10)])
    assert sum(len(m) for *_, m in bins_of(mostly, 8)) == 100


def test_a_failed_registration_is_an_infinite_error() -> None:
    assert quantiles([0.1, 0.2, 0.3, np.nan]) == [0.2, 0.3, np.inf, np.inf]
    assert all(np.isnan(q) for q in quantiles([]))
