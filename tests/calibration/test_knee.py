"""The knee: reported where errors have one, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.calibration.knee import knee
from rbtm_bench.core.types import Array

PAIRS, BLOCKS = 600, 30


def made(shape: str, seed: int = 0, noise: float = 0.25) -> tuple[Array, Array, Array]:
    """Scores, errors (m) and blocks whose log10 error follows a shape, with noise of its own and
    of the blocks."""
    random = np.random.default_rng(seed)
    s = random.uniform(0, 1, PAIRS)
    blocks = np.arange(PAIRS) // (PAIRS // BLOCKS)
    y = {
        "step": np.where(s < 0.6, -0.3, -1.6),
        "hinge": -1.6 + 5.0 * np.maximum(0.5 - s, 0),
        "line": -0.3 - 1.3 * s,
        "smooth": -1.0 - 0.6 * np.tanh(2.0 * (s - 0.5)),
        "none": np.full(PAIRS, -1.0),
        "upside down": np.where(s < 0.6, -1.6, -0.3),
    }[shape]
    y = y + random.normal(0, noise, PAIRS) + random.normal(0, 0.1, BLOCKS)[blocks]
    return s, 10**y, blocks


@pytest.mark.parametrize(("shape", "at"), [("step", 0.6), ("hinge", 0.5)])
def test_present(shape: str, at: float) -> None:
    result = knee(*made(shape))
    assert result.present, result.why
    assert result.threshold == pytest.approx(at, abs=0.06)
    assert result.low is not None and result.high is not None
    assert result.low <= at + 0.03 and result.high >= at - 0.03
    assert result.gain_low is not None and result.gain_low > 0
    assert result.why.startswith("knee at")


def test_the_rise_is_that_of_the_median() -> None:
    result = knee(*made("step", noise=0.05))
    assert result.model == "step"
    assert result.rise == pytest.approx(10**1.3, rel=0.1)


@pytest.mark.parametrize("shape", ["line", "smooth", "none"])
@pytest.mark.parametrize("seed", range(3))
def test_absent_where_errors_change_gradually(shape: str, seed: int) -> None:
    result = knee(*made(shape, seed))
    assert not result.present, result.why
    assert "predicts unseen errors as well" in result.why


def test_errors_that_rise_with_similarity_are_no_knee() -> None:
    result = knee(*made("upside down"))
    assert not result.present
    assert "do not rise faster below it" in result.why


def test_not_said_for_too_little() -> None:
    s, e, blocks = made("step")
    assert "cannot be said: 30 pairs" in knee(s[:30], e[:30], blocks[:30]).why
    assert "in 2 blocks" in knee(s, e, blocks % 2).why
    assert knee(np.ones(PAIRS), e, blocks).why == "cannot be said: nearly all scores are equal"
    assert knee(s, np.full(PAIRS, 0.2), blocks).why == "cannot be said: all errors are equal"
    assert not knee(s, np.full(PAIRS, np.nan), blocks).present


def test_most_scores_alike() -> None:
    """Every break lies above the least score, so that some pairs are below it."""
    s, e, blocks = made("none")
    result = knee(np.where(s < 0.3, 0.0, s), e, blocks)
    assert not result.present
    assert result.threshold is not None and result.threshold > 0 and result.rise is not None
    most = np.where(s < 0.97, 0.0, s)  # not even the highest break has a pair below it
    assert knee(most, e, blocks).why == "cannot be said: nearly all scores are equal"


def test_failures_are_large_errors_and_undefined_scores_are_left_out() -> None:
    s, e, blocks = made("step")
    failed, undefined = e.copy(), s.copy()
    failed[s < 0.6] = np.nan
    failed[np.flatnonzero(s < 0.6)[:10]] = 0.5
    assert knee(s, failed, blocks).present
    undefined[::10] = np.nan
    assert knee(undefined, e, blocks).present


def test_repeats() -> None:
    assert knee(*made("hinge")) == knee(*made("hinge"))
