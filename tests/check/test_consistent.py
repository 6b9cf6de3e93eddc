"""The check that compares a registration with its guess and with recent ones, by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rbtm_bench.check.consistent import FEWEST, Consistent
from rbtm_bench.core.geometry import se2
from rbtm_bench.core.types import Localizability, RegistrationResult

GUESS = se2(3.0, 4.0, 0.5)  # 5 m: sigma .1 + .1 * 5 = .6 m; 3 deg + 2.86 deg


def result(**fields: Any) -> RegistrationResult:
    named = {"T_target_source": GUESS, "converged": True, "fitness": 0.9} | fields
    return RegistrationResult(**{"inlier_rmse": 0.01, "inliers": 90, **named})


@pytest.mark.parametrize(
    ("off", "why"),
    [
        (se2(1.79, 0, 0), None),
        (se2(0, -1.82, 0), "1.82 m from the guess, 3.0 sigmas"),
        (se2(0, 0, np.radians(17.5)), None),
        (se2(0, 0, np.radians(-17.7)), "18 deg from the guess, 3.0 sigmas"),
    ],
)
def test_gates_grow_with_the_motion(off: np.ndarray, why: str | None) -> None:
    check = Consistent()
    assert check.reject(result(T_target_source=GUESS @ off), GUESS) == why
    assert check.reject_first(result(T_target_source=GUESS @ off), GUESS) is None
    short = se2(0.01, 0.0, 0.0)
    assert "sigmas" in str(check.reject(result(T_target_source=short @ se2(0.4, 0, 0)), short))


def test_fitness_is_held_against_what_was_accepted_lately() -> None:
    check = Consistent(history=FEWEST)
    low = result(fitness=0.6)
    for _ in range(FEWEST - 1):
        check.accept(result(fitness=0.95))
    assert check.reject(low, GUESS) is None  # too few to say what is usual
    check.accept(result(fitness=0.95))
    assert check.reject(low, GUESS) == "fitness 0.60, usually 0.95"
    for _ in range(FEWEST):  # a place where 0.6 is usual
        check.accept(low)
    assert check.reject(low, GUESS) is None
    assert Consistent(min_fitness=0.7).reject(low, GUESS) == "fitness 0.60 < 0.7"


def test_what_a_scan_cannot_see_and_what_fits_twice() -> None:
    blind = result(localizability=Localizability(np.diag([0.001, 0.5, 0.4]), 2.0))
    assert Consistent().reject(blind, GUESS) is None
    assert Consistent(min_localizability=0.01).reject(blind, GUESS) == "localizability 0.001 < 0.01"
    twice = result(search_peak_ratio=0.97)
    assert Consistent().reject(twice, GUESS) is None
    assert (
        Consistent(max_peak_ratio=0.95).reject(twice, GUESS) == "a second peak of 0.97 of the best"
    )
    assert Consistent().reject(result(converged=False), GUESS) == "not converged"
