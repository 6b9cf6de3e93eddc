"""Intervals, paired tests and clusters against values worked out by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rbtm_bench.core.types import Array
from rbtm_bench.datasets.carmen_log import parse_relations
from rbtm_bench.report import intervals
from rbtm_bench.report.intervals import (
    Interval,
    cluster_interval,
    holm,
    interval,
    mean_ranks,
    relation_clusters,
    signed_rank,
)

# --- intervals


def test_median_of_three_by_hand() -> None:
    # Of 27 samples with replacement 7 have the median 1 (at least two 1s): 26% > 2.5%.
    assert interval([2.0, 1.0, 3.0]) == Interval(2.0, 1.0, 3.0, 3)


def test_median_of_six_by_hand() -> None:
    # P(median = 1) is that of four 1s or more, 406 of 46656: 0.9%. P(median = 1.5) is that of
    # three 1s and a smallest other of 2, 20 * (125 - 64) of 46656: 2.6%. So 2.5% is reached at 1.5.
    assert interval([3, 1, 6, 2, 5, 4]) == Interval(3.5, 1.5, 5.5, 6)


def test_mean_of_six_by_hand() -> None:
    # The mean is k/6 with k binomial(6, 1/2): P(k = 0) = 1.6%, P(k <= 1) = 10.9%. The sample is
    # symmetric, so BCa corrects nothing.
    estimate = interval([0, 1, 0, 1, 0, 1], "mean")
    assert (estimate.value, estimate.n) == (0.5, 6)
    assert (estimate.low, estimate.high) == pytest.approx((1 / 6, 5 / 6))


def test_a_mean_of_skewed_values_reaches_further_up() -> None:
    estimate = interval([1, 1, 1, 1, 1, 1, 1, 1, 1, 21], "mean")
    assert estimate.low is not None and estimate.high is not None
    assert estimate.high - estimate.value > 2 * (estimate.value - estimate.low)


def test_equal_values_have_an_interval_of_no_length() -> None:
    for statistic in ("median", "mean"):
        estimate = interval([7.0] * 5, statistic)
        assert estimate == Interval(7.0, 7.0, 7.0, 5)


def test_few_values_have_none() -> None:
    assert interval([4.0]) == Interval(4.0, None, None, 1)
    assert interval([4.0, 6.0], "mean") == Interval(5.0, None, None, 2)
    with pytest.raises(ValueError, match="at least one value"):
        interval([])


def test_intervals_repeat_to_the_bit() -> None:
    values = np.random.default_rng(3).lognormal(size=11)
    assert interval(values) == interval(values)
    assert interval(values, "mean") == interval(values, "mean")


def test_excludes() -> None:
    assert Interval(2.0, 1.0, 3.0, 9).excludes(0.0) and Interval(-2.0, -3.0, -1.0, 9).excludes(0.0)
    assert not Interval(2.0, 0.0, 3.0, 9).excludes(0.0)
    assert not Interval(-2.0, -3.0, 0.0, 9).excludes(0.0)
    assert not Interval(2.0, None, None, 2).excludes(0.0)


# --- intervals over clusters

SIX = np.array([0.0, 1.0, 0.0, 1.0, 0.0, 1.0])


def test_copies_within_a_cluster_say_nothing_new() -> None:
    alone = cluster_interval(SIX, np.arange(6), np.zeros(6))
    many = cluster_interval(np.repeat(SIX, 10), np.repeat(np.arange(6), 10), np.zeros(60))
    assert alone == many and many.n == 6
    assert (many.low, many.high) == pytest.approx((1 / 6, 5 / 6))  # as the mean of six above
    naive = interval(np.repeat(SIX, 10), "mean")
    assert naive.low is not None and naive.low > 0.3  # what resampling relations would claim


def test_clusters_of_one_relation_are_as_independent_values() -> None:
    """Skewed ones, whose interval the acceleration moves up."""
    values = np.array([1.0, 1, 1, 1, 1, 1, 1, 1, 1, 21])
    found, alone = cluster_interval(values, np.arange(10), np.zeros(10)), interval(values, "mean")
    assert (found.value, found.n) == (alone.value, alone.n)
    assert (found.low, found.high) == pytest.approx((alone.low, alone.high))


def test_strata_keep_their_shares() -> None:
    # Half of the relations are local and have no error at all: the mean is half that of the rest.
    errors = np.concatenate([np.zeros(6), SIX])
    estimate = cluster_interval(errors, np.arange(12), np.repeat([True, False], 6))
    assert (estimate.value, estimate.n) == (0.25, 12)
    assert (estimate.low, estimate.high) == pytest.approx((1 / 12, 5 / 12))


def test_strata_of_unequal_shares_keep_them() -> None:
    # 18 of 24 relations are local and have no error: however many of the long ones' clusters are
    # drawn, the mean is a quarter of theirs, and so are the ends of the interval.
    errors = np.concatenate([np.zeros(18), SIX])
    found = cluster_interval(errors, np.arange(24), np.repeat([True, False], [18, 6]))
    assert (found.value, found.n) == (0.125, 24)
    assert (found.low, found.high) == pytest.approx((1 / 24, 5 / 24))


def test_a_large_cluster_weighs_by_its_relations() -> None:
    errors, clusters = np.array([1.0, 1.0, 1.0, 1.0, 0.0, 0.0]), np.array([5, 5, 5, 5, 8, 9])
    estimate = cluster_interval(errors, clusters, np.zeros(6))
    assert estimate.value == pytest.approx(4 / 6) and estimate.n == 3
    assert estimate.low == 0.0  # 8 of 27 samples have not got it
    assert estimate.high == 1.0  # one of 27 has nothing else


def test_errors_that_do_not_exist_are_left_out() -> None:
    errors = np.array([np.nan, 1.0, 2.0, 3.0, np.nan])
    estimate = cluster_interval(errors, np.array([0, 1, 2, 3, 4]), np.zeros(5))
    assert (estimate.value, estimate.n) == (2.0, 3)
    with pytest.raises(ValueError, match="at least one error"):
        cluster_interval(errors[:1], np.array([0]), np.zeros(1))


def test_no_interval_of_fewer_than_three_clusters() -> None:
    estimate = cluster_interval(np.arange(8.0), np.repeat([0, 1], 4), np.zeros(8))
    assert estimate == Interval(3.5, None, None, 2)
    strata = np.array([0, 0, 0, 1])  # a stratum of one cluster cannot be resampled
    assert cluster_interval(np.arange(4.0), np.arange(4), strata).low is None


def test_clusters_cover_where_relations_do_not() -> None:
    """19 clusters of the sizes of ACES, whose errors differ much more between than within."""
    rng = np.random.default_rng(5)
    sizes = np.array([14, 13, 11, 11, 8, 6, 5, 5, 3, 3, 2, 2, 1, 1, 1, 1, 1, 1, 1])
    clusters, truth = np.repeat(np.arange(19), sizes), np.exp(0.5)
    hits = {"clusters": 0, "relations": 0}
    for _ in range(100):
        errors = rng.lognormal(0, 1, 19)[clusters] * rng.lognormal(-0.02, 0.2, len(clusters))
        hits["clusters"] += not cluster_interval(errors, clusters, np.zeros(90)).excludes(truth)
        hits["relations"] += not interval(errors, "mean").excludes(truth)
    assert hits["clusters"] >= 70 and hits["relations"] <= 60


# --- clusters of relations


def labels(*ends: tuple[float, float], local: bool = False) -> list[int]:
    start, end = np.array(ends, np.float64).T
    return [int(i) for i in relation_clusters(start, end, np.full(len(ends), local))]


def test_long_relations_are_of_one_cluster_if_both_ends_are_near() -> None:
    assert labels((0, 100), (15, 110)) == [0, 0]
    assert labels((0, 100), (15, 125)) == [0, 1]  # one end is not enough
    assert labels((0, 100), (25, 110)) == [0, 1]
    assert labels((0, 100), (20, 120)) == [0, 0]  # 20 s still are
    assert labels((0, 100), (20.01, 120)) == [0, 1]


def test_clusters_are_chained() -> None:
    assert labels((0, 100), (15, 115), (30, 130), (90, 190)) == [0, 0, 0, 1]


def test_the_direction_of_a_relation_does_not_matter() -> None:
    assert labels((0, 100), (110, 15)) == [0, 0]


def test_clusters_are_numbered_by_time_whatever_the_order() -> None:
    assert labels((500, 900), (0, 100), (505, 905), (200, 300)) == [2, 0, 2, 1]


def test_local_relations_are_cut_into_blocks_of_time() -> None:
    # middles 10.5, 25.5, 40.4 | 40.5, 70.4 | 110: blocks of 30 s from 10.5 on, one is empty
    ends = [(10, 11), (25, 26), (40.3, 40.5), (40, 41), (70, 70.8), (110, 110)]
    assert labels(*ends, local=True) == [0, 0, 0, 1, 1, 2]


def test_local_and_long_relations_never_share_a_cluster() -> None:
    start, end = np.array([0.0, 0.0, 1.0]), np.array([31.0, 30.0, 32.0])
    labels = relation_clusters(start, end, np.array([False, True, False]))
    assert labels.tolist() == [0, 1, 0]
    assert len(relation_clusters(np.zeros(0), np.zeros(0), np.zeros(0, bool))) == 0


@pytest.mark.parametrize(("log", "long"), [("aces", 19), ("mit-csail", 9), ("intel", 92)])
def test_clusters_of_the_real_logs(data_dir: Path, log: str, long: int) -> None:
    path = data_dir / "freiburg" / f"{log}.relations"
    relations = parse_relations(str(path), path.read_bytes())
    start, end = relations.start, relations.end
    local = np.abs(end - start) <= 30.0
    labels = relation_clusters(start, end, local)
    assert len(np.unique(labels[~local])) == long
    assert len(np.unique(labels)) == labels.max() + 1 == long + len(np.unique(labels[local]))
    order = np.random.default_rng(0).permutation(len(start))
    again = relation_clusters(start[order], end[order], local[order])
    assert np.array_equal(again, labels[order])


# --- paired tests


def test_signed_rank_by_hand() -> None:
    assert signed_rank([1, 2, 3, 4, 5, 6]) == 2 / 64  # all signs alike: 1 of 64, two sides
    assert signed_rank([-1, 2, 3, 4, 5, 6]) == 4 / 64  # rank sums 0 and 1
    assert signed_rank([1, -2, 3, 4, 5, 6]) == 6 / 64  # 0, 1 and 2
    assert signed_rank([-1, -2, -3, -4, -5, -6, -7]) == 2 / 128


def test_ties_stay_exact() -> None:
    assert signed_rank([2, 2, 2, 2, 2, 2]) == 2 / 64
    # ranks 3.5 each: a sum of at most 3.5 is none or one negative, 1 + 6 of 64
    assert signed_rank([-2, 2, 2, 2, 2, 2]) == pytest.approx(14 / 64)


def test_pairs_without_a_difference_are_dropped() -> None:
    assert signed_rank([0, 1, 2, 3, 4, 5]) == 2 / 32
    assert signed_rank(range(15)) == 2 / 2**14  # exact, as without the 0
    assert signed_rank([0.0] * 8) is None  # the same thing by two names


def test_fewer_than_six_pairs_are_not_tested() -> None:
    assert signed_rank([1, 2, 3, 4, 5]) is None
    assert intervals.INDEPENDENT == 6


def test_holm_by_hand() -> None:
    # sorted .005 .01 .03 .04, times 4 3 2 1: .02 .03 .06 .04, and never less than the one before
    assert holm([0.01, 0.04, None, 0.03, 0.005]) == pytest.approx([0.03, 0.06, None, 0.06, 0.02])
    assert holm([0.9, 0.6]) == [1.0, 1.0]
    assert holm([]) == [] and holm([None]) == [None]


def test_mean_ranks_by_hand() -> None:
    values: Array = np.array([[1.0, 2, 3], [1, 3, 2], [5, 5, 9], [1, 2, 3], [1, 2, 3], [3, 2, 1]])
    ranks = mean_ranks(values)
    assert ranks is not None
    # firsts: 1 1 1.5 1 1 3; seconds: 2 3 1.5 2 2 2; thirds: 3 2 3 3 3 1
    assert ranks.tolist() == pytest.approx([8.5 / 6, 12.5 / 6, 15 / 6])
    assert mean_ranks(values[:5]) is None
