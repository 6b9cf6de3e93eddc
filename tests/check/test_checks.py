"""Which registrations are believed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rbtm_bench.check.gated import Gated
from rbtm_bench.check.none import AcceptAll
from rbtm_bench.core.geometry import se2, se3
from rbtm_bench.core.types import Array, RegistrationResult

GUESS = se2(10.0, -4.0, 2.0)


def result(T: Array = GUESS, **fields: Any) -> RegistrationResult:
    defaults: dict[str, Any] = {
        "converged": True,
        "fitness": 0.9,
        "inlier_rmse": 0.01,
        "inliers": 90,
    }
    return RegistrationResult(T, **{**defaults, **fields})


def about_x(degrees: float) -> Array:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return se3([0, 0, 0], [[1, 0, 0], [0, c, -s], [0, s, c]])


@pytest.mark.parametrize(
    ("registration", "why_not"),
    [
        (result(), None),
        (result(converged=None), None),  # the library does not say
        (result(converged=False), "not converged"),
        (result(fitness=0.3), None),  # exactly enough
        (result(fitness=0.299), "fitness 0.30 < 0.3"),
        (result(fitness=0.0), "fitness 0.00 < 0.3"),
        (result(GUESS @ se2(0.499, 0, 0)), None),
        (result(GUESS @ se2(0.3, -0.41, 0)), "0.51 m from the guess"),  # 0.508
        (result(se2(0.1, 0.1, 0) @ GUESS), None),
        (result(GUESS @ se2(0, 0, np.radians(29.9))), None),
        (result(GUESS @ se2(0, 0, np.radians(-31))), "31 deg from the guess"),
        (result(GUESS @ about_x(31)), "31 deg from the guess"),
        (result(np.eye(4)), "10.77 m from the guess"),
    ],
)
def test_gated(registration, why_not) -> None:
    assert Gated(0.3, 0.5, 30.0).reject(registration, GUESS) == why_not


def test_the_gates_are_settings() -> None:
    far = result(GUESS @ se2(0.8, 0, np.radians(50)), fitness=0.1)
    assert Gated(0.1, 0.9, 60.0).reject(far, GUESS) is None
    assert Gated(0.2, 0.9, 60.0).reject(far, GUESS) == "fitness 0.10 < 0.2"
    assert Gated(0.1, 0.7, 60.0).reject(far, GUESS) == "0.80 m from the guess"
    assert Gated(0.1, 0.9, 40.0).reject(far, GUESS) == "50 deg from the guess"


def test_the_distance_is_that_of_the_correction_not_of_the_motion() -> None:
    """Far from the model scan, and as guessed: fine."""
    assert Gated().reject(result(se2(100, 0, 3)), se2(100, 0, 3)) is None


def test_accept_all() -> None:
    hopeless = result(se2(1000, 0, 1), converged=False, fitness=0.0)
    assert AcceptAll().reject(hopeless, GUESS) is None


def test_no_distance_from_a_guess_that_knows_no_motion() -> None:
    """A car's first motion is further than any gate: only fit and convergence are asked for."""
    far = result(GUESS @ se2(3.0, 0.0, 0.0))
    assert Gated().reject(far, GUESS) == "3.00 m from the guess"
    assert Gated().reject_first(far, GUESS) is None
    assert Gated().reject_first(result(fitness=0.1), GUESS) == "fitness 0.10 < 0.3"
    assert Gated().reject_first(result(converged=False), GUESS) == "not converged"
