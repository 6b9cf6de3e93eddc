"""Believe a registration that converged, fits, and stays near its guess."""

from __future__ import annotations

import math
from typing import Annotated

from annotated_types import Gt

from rbtm_bench.check.base import Check
from rbtm_bench.core.kinds import Distance, ShareThreshold
from rbtm_bench.core.rigid import apart
from rbtm_bench.core.types import Array, RegistrationResult


class Gated(Check):
    """Rejects when ``converged`` is False (None passes: the library does not say), when fitness
    is below ``min_fitness``, or when the result is further than ``max_translation`` m or
    ``max_rotation_deg`` from its initial guess.

    Both distances are from a predicted motion. Where none is known yet (``guess=constant_velocity``
    until the first registration is accepted) they do not apply: a car would fail there for good."""

    def __init__(
        self,
        min_fitness: ShareThreshold = 0.3,
        max_translation: Distance = 0.5,
        max_rotation_deg: Annotated[float, Gt(0)] = 30.0,
    ) -> None:
        self.min_fitness = min_fitness
        self.max_translation = max_translation
        self.max_rotation_deg = max_rotation_deg

    def reject(self, result: RegistrationResult, T_guess: Array) -> str | None:
        poor = self.reject_first(result, T_guess)
        if poor is not None:
            return poor
        distance, turn = apart(T_guess, result.T_target_source)
        if distance > self.max_translation:
            return f"{distance:.2f} m from the guess"
        angle = math.degrees(turn)
        if angle > self.max_rotation_deg:
            return f"{angle:.0f} deg from the guess"
        return None

    def reject_first(self, result: RegistrationResult, T_guess: Array) -> str | None:
        if result.converged is False:
            return "not converged"
        if result.fitness < self.min_fitness:
            return f"fitness {result.fitness:.2f} < {self.min_fitness:g}"
        return None
