"""The knee: found where there is one, and only there."""

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
def test_found(shape: str, at: float) -> None:
    found = knee(*made(shape))
    assert found.found, found.why
    assert found.threshold == pytest.approx(at, abs=0.06)
    assert found.low is not None and found.high is not None
    assert found.low <= at + 0.03 and found.high >= at - 0.03
    assert found.gain_low is not None and found.gain_low > 0
    assert found.why.startswith("knee at")


def test_the_rise_is_that_of_the_median() -> None:
    found = knee(*made("step", noise=0.05))
    assert found.model == "step"
    assert found.rise == pytest.approx(10**1.3, rel=0.1)


@pytest.mark.parametrize("shape", ["line", "smooth", "none"])
@pytest.mark.parametrize("seed", range(3))
def test_not_found_where_errors_change_gradually(shape: str, seed: int) -> None:
    found = knee(*made(shape, seed))
    assert not found.found, found.why
    assert "predicts unseen errors as well" in found.why


def test_errors_that_rise_with_similarity_are_no_knee() -> None:
    found = knee(*made("upside down"))
    assert not found.found
    assert "do not rise faster below it" in found.why


def test_not_said_for_too_little() -> None:
    s, e, blocks = made("step")
    assert "cannot be said: 30 pairs" in knee(s[:30], e[:30], blocks[:30]).why
    assert "in 2 blocks" in knee(s, e, blocks % 2).why
    assert knee(np.ones(PAIRS), e, blocks).why == "cannot be said: nearly all scores are equal"
    assert knee(s, np.full(PAIRS, 0.2), blocks).why == "cannot be said: all errors are equal"
    assert not knee(s, np.full(PAIRS, np.nan), blocks).found


def test_most_scores_alike() -> None:
    """Every break lies above the least score, so that there are pairs below it."""
    s, e, blocks = made("none")
    found = knee(np.where(s < 0.3, 0.0, s), e, blocks)
    assert not found.found
    assert found.threshold is not None and found.threshold > 0 and found.rise is not None
    most = np.where(s < 0.97, 0.0, s)  # not even the highest break has a pair below it
    assert knee(most, e, blocks).why == "cannot be said: nearly all scores are equal"


def test_failures_are_large_errors_and_undefined_scores_are_left_out() -> None:
    s, e, blocks = made("step")
    failed, undefined = e.copy(), s.copy()
    failed[s < 0.6] = np.nan
    failed[np.flatnonzero(s < 0.6)[:10]] = 0.5
    assert knee(s, failed, blocks).found
    undefined[::10] = np.nan
    assert knee(undefined, e, blocks).found


def test_repeats() -> None:
    assert knee(*made("hinge")) == knee(*made("hinge"))
