"""What plug-ins hand to the loop is checked once, and a wrong answer names its plug-in."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from loop_helpers import Script, drive, method

from rbtm_bench.odometry.loop import odometry
from rbtm_bench.selection.previous import Previous
from rbtm_bench.selection.rbtm import Rbtm
from rbtm_bench.similarity.base import checked_scores


@pytest.mark.parametrize(
    ("scores", "message"),
    [
        (np.array([0.5, np.inf]), "a score is infinite"),
        (np.array([0.5 + 1j, 0.2]), r"expected real ones, \(2,\)"),
        (np.zeros(3), r"scores of shape \(3,\)"),
        (0.5, r"scores of shape \(\)"),
    ],
)
def test_scores_that_are_none(scores: Any, message: str) -> None:
    with pytest.raises(ValueError, match=f"Script: .*{message}"):
        checked_scores(Script(), scores, (2,))


def test_scores_that_are_some() -> None:
    given = checked_scores(Script(), np.array([1, 0], dtype=np.int8), (2,))
    assert given.dtype == np.float64 and given.tolist() == [1.0, 0.0]
    undefined = np.array([np.nan, 0.5])
    assert checked_scores(Script(), undefined, (2,)) is undefined


@pytest.mark.parametrize("position", [-1, 3, 0.0, True, None])
def test_a_position_that_the_window_has_not(position: Any) -> None:
    class Wild(Previous):
        def order(self, scan, models, scores):
            return [(position, "a guess")] if scan == 3 else super().order(scan, models, scores)

    wild = Wild()
    wild.capacity = 3
    with pytest.raises(ValueError, match=r"Wild chose position .* in a window of 3"):
        list(odometry(drive(5), method(selector=wild)))


@pytest.mark.parametrize("which", [-1, 2])
def test_a_registration_that_was_not_accepted_cannot_be_picked(which: int) -> None:
    class Wild(Rbtm):
        def pick(self, scan, trials):
            return which, "a guess"

    with pytest.raises(ValueError, match=r"Wild\.pick chose .* of 1 registrations"):
        list(odometry(drive(4), method(selector=Wild(window=3))))
