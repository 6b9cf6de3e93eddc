"""What a selector picked first, before the check, and when the first motion is let through."""

from __future__ import annotations

import numpy as np
import pytest
from loop_helpers import NAN

from rbtm_bench.core.step_columns import DECIDED, PICKS
from rbtm_bench.core.types import Node, StepRecord, StepTable
from rbtm_bench.guess.constant_velocity import ConstantVelocity
from rbtm_bench.metrics.summary import summarise_steps, why_unregistered
from rbtm_bench.odometry import rows
from rbtm_bench.selection.base import Selection
from rbtm_bench.selection.oldest import Oldest
from rbtm_bench.selection.rbtm import Rbtm
from rbtm_bench.selection.window import Window


def filled(count: int, capacity: int = 3) -> Window:
    window = Window(capacity)
    for scan in range(count):
        window.push(Node(scan, 0.1 * scan, np.eye(4)))
    return window


@pytest.mark.parametrize(
    ("scores", "pick"),
    [
        ([0.9, 0.9, 0.9], "oldest"),
        ([0.1, 0.9, 0.9], "middle"),
        ([0.1, 0.1, 0.9], "newest"),
        ([0.1, NAN, 0.1], "none"),  # the fallback is no pick
        ([NAN, NAN, NAN], "undefined"),
    ],
)
def test_first_picks_of_a_full_window(scores: list[float], pick: str) -> None:
    rbtm, window = Rbtm(window=4, threshold=0.5), filled(3)
    assert rows.first_pick(window, rbtm.choose(3, window, np.array(scores)), rbtm) == pick


def test_no_pick_before_the_window_is_full_nor_without_scores() -> None:
    rbtm, window = Rbtm(window=4), filled(2)
    assert rows.first_pick(window, rbtm.choose(2, window, np.ones(2)), rbtm) == ""
    assert rows.first_pick(Window(3), Selection(()), rbtm) == ""
    oldest, window = Oldest(window=4), filled(3)
    selection = oldest.choose(3, window, np.full(3, NAN))
    assert rows.first_pick(window, selection, oldest) == ""


def test_shares_sum_to_one_over_full_windows() -> None:
    picks = ["", "", "oldest", "middle", "newest", "none", "none", "undefined", "oldest", "oldest"]
    steps = StepTable([StepRecord(i, 0.1 * i, pick=pick) for i, pick in enumerate(picks)])
    values = summarise_steps(steps)
    assert values["pick_oldest"] == 3 / 8 and values["pick_none"] == 2 / 8
    assert sum(values[f"pick_{name}"] or 0.0 for name in PICKS) == 1.0
    assert values["decided"] == 2 / 8 and set(DECIDED) < set(PICKS)
    none = summarise_steps(StepTable([StepRecord(0, 0.0), StepRecord(1, 0.1)]))
    assert none["decided"] is None and none["pick_oldest"] is None


def test_the_most_frequent_reason_whatever_its_numbers() -> None:
    told = ["", "0.61 m from the guess", "not converged", "0.72 m from the guess"]
    steps = StepTable(
        [StepRecord(i, 0.1 * i, status="predicted", reason=why) for i, why in enumerate(told)]
    )
    assert why_unregistered(steps) == "0.61 m from the guess"
    assert why_unregistered(StepTable([StepRecord(0, 0.0)])) == ""


def test_constant_velocity_has_a_motion_once_something_has_moved() -> None:
    here, there = np.eye(4), np.eye(4)
    there[0, 3] = 0.9
    first, still, moved = (Node(i, 0.1 * i, T) for i, T in enumerate((here, here, there)))
    guess = ConstantVelocity()
    assert not guess.has_motion([first]) and not guess.has_motion([first, still])
    assert guess.has_motion([still, moved])
