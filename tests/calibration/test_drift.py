"""Drift of a chain: the formula by hand, composed errors against it, and what resampling says."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rbtm_bench.calibration.drift import PairErrors, drift, noise_drift, straight_line
from rbtm_bench.calibration.shortlist import Gap, Shortlist
from rbtm_bench.core.geometry import se2
from rbtm_bench.core.types import Array

K, BLOCK = 400, 10


def line(scans: int = 101, step: float = 0.1) -> Array:
    return np.stack([se2(step * i, 0.0, 0.0) for i in range(scans)])


def circle(scans: int = 101, radius: float = 2.0) -> Array:
    angles = 2 * np.pi * np.arange(scans) / (scans - 1)
    return np.stack([se2(radius * np.sin(a), radius * (1 - np.cos(a)), a) for a in angles])


def errors(
    along: float = 0.0, bias_deg: float = 0.0, m: float = 0.0, deg: float = 0.0, seed: int = 0
) -> PairErrors:
    """A mean along and of the heading, and normal errors of m a side and deg."""
    random = np.random.default_rng(seed)
    shift, turn = np.zeros((2, K, 3))
    shift[:, :2] = random.normal(0.0, 1.0, (K, 2)) * m + [along, 0.0]
    turn[:, 2] = np.radians(bias_deg + deg * random.normal(0.0, 1.0, K))
    return PairErrors(shift, turn, np.arange(K) // BLOCK, np.ones(K))


def test_the_formula_by_hand() -> None:
    mean, covariance = np.zeros(6), np.zeros((6, 6))
    mean[0] = -0.002
    assert straight_line(mean, covariance, 50, 10.0) == pytest.approx(0.1)  # 50 x 2 mm
    covariance[0, 0] = covariance[1, 1] = 0.01**2
    both = math.sqrt(0.1**2 + 50 * 2 * 0.01**2)
    assert straight_line(mean, covariance, 50, 10.0) == pytest.approx(both)
    covariance[5, 5] = 0.002**2  # random heading: 50 s^2 L^2 / 3
    swung = math.sqrt(both**2 + 50 * 0.002**2 * 10.0**2 / 3)
    assert straight_line(mean, covariance, 50, 10.0) == pytest.approx(swung)
    mean[5] = 0.001  # biased heading: 50 b L / 2 = 0.25
    assert straight_line(mean, covariance, 50, 10.0) == pytest.approx(math.hypot(swung, 0.25))
    random = 50 * 0.01**2 + 50 * 0.002**2 * 100 / 3
    of_mean = 50**2 / 8 * (0.01**2 + 0.002**2 * 100 / 4)  # of eight blocks
    assert noise_drift((0.01, 0.002), 50, 10.0, 8) == pytest.approx(math.sqrt(random + of_mean))


def test_more_registrations_drift_more() -> None:
    of = errors(along=-0.002)
    drifts = [drift(of, line(), gap).value for gap in (1, 2, 10)]
    assert drifts == pytest.approx([0.2, 0.1, 0.02])


@pytest.mark.parametrize(
    "what",
    [{"along": -0.002}, {"m": 0.01}, {"deg": 0.3}, {"bias_deg": 0.05}, {"m": 0.01, "deg": 0.2}],
)
def test_composed_errors_agree_with_the_formula(
    what: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    of = errors(**what)
    by_formula = drift(of, line(), 2)
    monkeypatch.setattr("rbtm_bench.calibration.drift.STRAIGHT", 2.0)  # no path is straight
    composed = drift(of, line(), 2)
    assert composed.value == pytest.approx(by_formula.value, rel=0.2)
    assert composed.low is not None and composed.low <= composed.value * 1.001


def test_on_a_circle_a_constant_error_comes_back() -> None:
    """As long as it is along: what is lost on the way out is lost on the way back as well."""
    assert drift(errors(along=-0.002), circle(), 1).value < 0.02
    assert drift(errors(m=0.01), circle(), 1).value == pytest.approx(0.14, rel=0.2)


def test_failures_count_and_weights_choose() -> None:
    of = errors(m=0.001)
    of.shift[::50] = [1.0, 0.0, 0.0]  # one in fifty is a metre off
    assert drift(of, line(), 1).value > 1.5
    weight = np.ones(K)
    weight[::50] = 0.0
    some = weight > 0
    spared = PairErrors(of.shift[some], of.turn[some], of.block[some], weight[some])
    assert drift(spared, line(), 1).value < 0.02
    rare = PairErrors(of.shift, of.turn, of.block, np.where(np.arange(K) % 50, 1.0, 1e-6))
    assert drift(rare, circle(), 1).value < 0.05


def test_intervals_are_of_blocks_and_repeat() -> None:
    random = np.random.default_rng(1)
    of = errors(m=0.001)
    of.shift[:, 0] += random.normal(0.0, 0.01, K // BLOCK)[of.block]
    wide, narrow = drift(of, line(), 1), drift(errors(m=0.01), line(), 1)
    assert wide.n == narrow.n == K // BLOCK
    assert wide.high / wide.low > 1.3 * narrow.high / narrow.low  # type: ignore[operator]
    assert drift(of, circle(), 3) == drift(of, circle(), 3)


def test_what_the_truth_s_own_errors_would_hide() -> None:
    """Errors as small as the least spread of any gap may be the truth's; ten times as large not."""
    small, large, biased = errors(m=0.01), errors(m=0.1), errors(m=0.01, along=0.2)
    path = line()
    gaps = [
        Gap(gap, K, of, 1.0, drift(of, path, gap))
        for gap, of in ((1, large), (4, small), (8, biased))
    ]
    lister = Shortlist.__new__(Shortlist)
    lister.path, lister._exact = path, False
    judged = lister._judged(gaps)
    assert [bool(g.unsure) for g in judged] == [False, True, False]  # a bias is none of noise
    assert "errors of the truth of 0.01" in judged[1].unsure
    lister._exact = True
    assert not any(g.unsure for g in lister._judged(gaps))
