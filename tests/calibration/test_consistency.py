"""The stand-in for errors: what contradicts itself, and what it cannot see."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.calibration.consistency import contradiction
from rbtm_bench.calibration.measuring import Task, _disturbed_starts
from rbtm_bench.core.geometry import inverse, se2
from rbtm_bench.core.types import Array, RegistrationResult

POSES = {0: se2(0, 0, 0), 2: se2(1, 0, 0.1), 4: se2(2, 0.5, 0.3)}
STARTS = {(t, s): np.eye(4) for t in POSES for s in POSES}


def result(T: Array) -> RegistrationResult:
    return RegistrationResult(T, True, 1.0, 0.0, 10)


def true(target: int, source: int) -> Array:
    return inverse(POSES[target]) @ POSES[source]


def test_the_truth_does_not_contradict_itself() -> None:
    _, metres, degrees = contradiction(0, 4, 2, STARTS, lambda t, s, _: result(true(t, s)))
    assert metres == pytest.approx(0.0, abs=1e-12) and degrees == pytest.approx(0.0, abs=1e-9)


def test_an_error_in_one_direction_is_seen() -> None:
    def register(target: int, source: int, guess: Array) -> RegistrationResult:
        wrong = se2(0.3, 0, 0) if (target, source) == (0, 4) else np.eye(4)
        return result(true(target, source) @ wrong)

    forward, metres, _ = contradiction(0, 4, -1, STARTS, register)
    assert metres == pytest.approx(0.3)
    np.testing.assert_allclose(forward.T_target_source, true(0, 4) @ se2(0.3, 0, 0))


def test_an_error_on_the_way_is_seen_by_the_loop_alone() -> None:
    def register(target: int, source: int, guess: Array) -> RegistrationResult:
        wrong = se2(0, 0, np.radians(7)) if (target, source) == (2, 4) else np.eye(4)
        return result(true(target, source) @ wrong)

    assert contradiction(0, 4, -1, STARTS, register)[2] == pytest.approx(0.0, abs=1e-9)
    assert contradiction(0, 4, 2, STARTS, register)[2] == pytest.approx(7.0)


def test_the_same_error_everywhere_is_not_seen() -> None:
    """Why it is a stand-in only: a method that never sees motion agrees with itself."""
    _, metres, degrees = contradiction(0, 4, 2, STARTS, lambda t, s, _: result(np.eye(4)))
    assert (metres, degrees) == (0.0, 0.0)


def test_a_method_that_hands_back_its_guess_fails() -> None:
    metres = []
    for number in range(50):
        task = Task(number, 0, 4, true(0, 4), None, 2, np.stack([true(0, 2), true(2, 4)]), seed=3)
        starts = _disturbed_starts(task, planar=True)
        metres.append(contradiction(0, 4, 2, starts, lambda t, s, guess: result(guess))[1])
    assert np.mean(np.array(metres) > 0.1) > 0.95
