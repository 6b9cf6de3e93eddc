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
        "logistic": -1.6 + 1.3 / (1 + np.exp(2 * np.log(9) * (s - 0.5) / 0.08)),
        "line": -0.3 - 1.3 * s,
        "smooth": -1.0 - 0.6 * np.tanh(2.0 * (s - 0.5)),
        "none": np.full(PAIRS, -1.0),
        "upside down": np.where(s < 0.6, -1.6, -0.3),
    }[shape]
    y = y + random.normal(0, noise, PAIRS) + random.normal(0, 0.1, BLOCKS)[blocks]
    return s, 10**y, blocks


@pytest.mark.parametrize(("shape", "at"), [("step", 0.6), ("logistic", 0.5)])
def test_present(shape: str, at: float) -> None:
    result = knee(*made(shape))
    assert result.present, result.why
    assert result.why.startswith("knee at") and result.threshold is not None
    assert result.threshold.value == pytest.approx(at, abs=0.06)
    assert result.threshold.low <= at + 0.03 and result.threshold.high >= at - 0.03


def test_width_and_height_are_those_of_the_step() -> None:
    """10 to 90 % of the logistic lie within 0.08 of the score; errors rise twentyfold."""
    result = knee(*made("logistic", noise=0.1))
    sharp = knee(*made("step", noise=0.1))
    assert result.width is not None and result.rise is not None and sharp.width is not None
    assert result.width.low <= 0.08 <= result.width.high + 0.03
    assert sharp.width.value < 0.03 and sharp.width.low <= sharp.width.value <= sharp.width.high
    assert result.rise.value == pytest.approx(10**1.3, rel=0.3)
    assert result.rise.low < 10**1.3 < 1.2 * result.rise.high


@pytest.mark.parametrize("shape", ["line", "smooth", "none"])
@pytest.mark.parametrize("seed", range(3))
def test_absent_where_errors_change_gradually(shape: str, seed: int) -> None:
    result = knee(*made(shape, seed + 10))
    assert not result.present, result.why
    assert result.smallest is not None and 1.1 < result.smallest < 3.0
    assert f"less than {result.smallest:.2g} times would not have shown" in result.why


def test_the_smallest_jump_falls_with_the_pairs() -> None:
    s, e, blocks = made("none")
    few = knee(s[::3], e[::3], blocks[::3]).smallest
    every = knee(s, e, blocks).smallest
    assert few is not None and every is not None and few > 1.1 * every


def test_errors_that_rise_with_similarity_are_no_knee() -> None:
    result = knee(*made("upside down"))
    assert not result.present and result.p is not None and result.p > 0.5


def test_not_said_for_too_little() -> None:
    s, e, blocks = made("step")
    assert "cannot be said: 30 pairs" in knee(s[:30], e[:30], blocks[:30]).why
    assert "in 2 blocks" in knee(s, e, blocks % 2).why
    assert knee(np.ones(PAIRS), e, blocks).why == "cannot be said: nearly all scores are equal"
    assert knee(s, np.full(PAIRS, 0.2), blocks).why == "cannot be said: all errors are equal"
    assert not knee(s, np.full(PAIRS, np.nan), blocks).present


def test_most_scores_alike() -> None:
    s, e, blocks = made("none")
    assert not knee(np.where(s < 0.3, 0.0, s), e, blocks).present
    most = np.where(s < 0.97, 0.0, s)  # hardly any above the others
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
    assert knee(*made("logistic")) == knee(*made("logistic"))
