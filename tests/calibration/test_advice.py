"""Threshold and window: what RBTM would choose, what that promises, and what is advised."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from rbtm_bench.calibration import analysis
from rbtm_bench.calibration.advice import Evidence, advise, choices, promise, thresholds

GROUPS = np.array([1, 2, 4])


def evidence(seed: int = 0, limit: float = 0.5, worth: float = 0.98) -> Evidence:
    """Scores fall with the gap; pairs above ``limit`` succeed with a chance of ``worth``, those
    below with 0.3."""
    random = np.random.default_rng(seed)
    anchors = 200
    offered = np.array([0.9, 0.65, 0.5]) + random.uniform(-0.1, 0.1, (anchors, 3))
    score, group = offered.T.ravel(), np.repeat(GROUPS, anchors)
    chance = np.where(score > limit, worth, 0.3)
    success = random.random(len(score)) < chance
    return Evidence(score, success, group, np.tile(np.arange(anchors) // 4, 3), offered, GROUPS)


def test_the_oldest_that_passes() -> None:
    offered = np.array([[0.9, 0.8, 0.1], [0.9, 0.2, 0.8], [0.1, 0.1, 0.1], [np.nan, 0.9, np.nan]])
    every = np.ones(3, bool)
    assert choices(offered, 0.5, every).tolist() == [1, 2, -1, 1]
    assert choices(offered, 0.5, np.array([True, True, False])).tolist() == [1, 0, -1, 1]
    assert choices(offered, 0.8, every).tolist() == [0, 0, -1, 1]  # exceeds: 0.8 does not
    assert choices(np.zeros((2, 0)), 0.5, np.zeros(0, bool)).tolist() == [-1, -1]


def test_a_promise_weighs_success_by_how_often_a_gap_is_chosen() -> None:
    # two scans in three would take gap 2, one gap 1; 60 pairs of each gap, one a block
    offered = np.array([[0.9, 0.9], [0.9, 0.9], [0.9, 0.1]])
    group, success = np.repeat([1, 2], 60), np.r_[np.ones(60, bool), np.arange(60) < 30]
    both = promise(
        Evidence(np.full(120, 0.8), success, group, np.arange(120), offered, np.array([1, 2])),
        0.5,
        window=3,
    )
    assert both.success is not None
    assert both.success.value == pytest.approx(2 / 3 * 0.5 + 1 / 3 * 1.0)
    assert (both.used, both.reach, both.pairs) == (1.0, pytest.approx(5 / 3), 120)
    assert not both.all_pass
    small = promise(
        Evidence(np.full(120, 0.8), success, group, np.arange(120), offered, np.array([1, 2])),
        0.5,
        window=2,
    )
    assert small.success is not None and small.success.value == 1.0 and small.all_pass


def test_too_few_pairs_promise_nothing() -> None:
    offered = np.full((5, 1), 0.9)
    few = Evidence(
        np.full(20, 0.8), np.ones(20, bool), np.ones(20, int), np.arange(20), offered, np.array([1])
    )
    assert promise(few, 0.5, 2).success is None
    advice = advise(few, few, 0.9)
    assert advice.chosen is None and advice.why.startswith("no advice")
    assert promise(few, 0.5, 2, least=1).success is not None


def test_the_advice_reaches_back_as_far_as_it_may() -> None:
    advice = advise(evidence(0), evidence(1), 0.9)
    assert advice.reached and advice.chosen is not None and advice.reported is not None
    assert advice.chosen.window == 5
    assert advice.chosen.threshold == pytest.approx(0.5, abs=0.041)
    assert advice.chosen.success is not None and advice.chosen.success.cautious >= 0.9
    assert advice.reported.success is not None and advice.reported.success.value > 0.9
    assert advice.reported.threshold == advice.chosen.threshold


def test_a_rate_that_nothing_reaches_is_reported() -> None:
    advice = advise(evidence(0, worth=0.7), evidence(1, worth=0.7), 0.95)
    assert not advice.reached and advice.chosen is not None
    assert advice.why.startswith("no threshold and window promise 95%")


def test_the_reported_part_does_not_decide() -> None:
    a, b = (advise(evidence(0), evidence(seed), 0.9) for seed in (1, 2))
    assert a.chosen == b.chosen and a.reported != b.reported


def test_thresholds_are_round_and_cover_the_scores() -> None:
    tried = thresholds(np.array([0.111, np.nan, 0.25]))
    np.testing.assert_allclose(tried, [0.08, 0.10, 0.12, 0.14, 0.16, 0.18, 0.20, 0.22, 0.24, 0.26])
    assert thresholds(np.array([-1.0, 0.0])).min() == -1.0
    assert len(thresholds(np.array([np.nan]))) == 0


def test_a_part_whose_windows_offer_nothing() -> None:
    """Short blocks of a log with relations: pairs, but no scan with all gaps behind it."""
    pairs = pd.DataFrame(
        {"data": 0, "kind": "gap", "part": "reported", "group": 1, "cluster": [0, 1]}
    )
    outcome = pd.DataFrame({"success": [True, False]})
    windows = pd.DataFrame({"data": [0], "source": [9], "group": [1], "part": ["calibration"]})
    scores, offered = {"s": np.array([0.5, 0.6])}, {"s": np.array([0.7])}
    measured = analysis.Measured(pairs, {"b": outcome}, scores, windows, offered, {})
    nothing = analysis.evidence(measured, outcome, "s", "reported")
    assert nothing.offered.shape == (0, 0)
    assert promise(nothing, 0.1, 2).success is None
    assert not analysis.advices(measured, 0.9)["b", "s"].reached
