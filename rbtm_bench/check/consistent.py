"""Believe a registration that agrees with its guess, with recent ones, and with itself."""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import Annotated

from annotated_types import Ge, Gt, Le

from rbtm_bench.check.base import Check
from rbtm_bench.core.geometry import rotation_angle, translation_norm
from rbtm_bench.core.kinds import ShareThreshold
from rbtm_bench.core.rigid import apart
from rbtm_bench.core.types import Array, RegistrationResult

Share = Annotated[float, Ge(0)]

FEWEST = 5
"""Accepted registrations before their fitness says what is usual."""


class Consistent(Check):
    """Rejects what an absolute bound on fitness does not see: a wrong match of similar places.

    - ``converged`` False, or fitness below ``min_fitness``;
    - fitness below ``usual`` times the median of the last ``history`` accepted ones: a place where
      0.95 is common makes 0.6 suspicious, one full of people does not;
    - localizability (its smallest eigenvalue) below ``min_localizability``;
    - further than ``sigmas`` standard deviations from the guess, translation or rotation. These
      grow with the motion that the guess stands for: ``translation_sigma`` m and
      ``translation_share`` of the distance, ``rotation_sigma_deg`` and ``rotation_share`` of the
      turn. A gate in m alone is too wide for a robot and too narrow for a car;
    - with a search that looked for it, a second peak of at least ``max_peak_ratio`` of the best.

    Where no motion is known yet the gates do not apply (as for ``Gated``).
    """

    def __init__(
        self,
        min_fitness: ShareThreshold = 0.3,
        usual: Annotated[float, Ge(0), Le(1)] = 0.7,
        history: Annotated[int, Ge(FEWEST)] = 20,
        min_localizability: Share = 0.0,
        sigmas: Annotated[float, Gt(0)] = 3.0,
        translation_sigma: Share = 0.1,
        translation_share: Share = 0.1,
        rotation_sigma_deg: Share = 3.0,
        rotation_share: Share = 0.1,
        max_peak_ratio: Annotated[float, Gt(0), Le(1)] = 1.0,
    ) -> None:
        self.min_fitness, self.usual = min_fitness, usual
        self.min_localizability = min_localizability
        self.sigmas, self.max_peak_ratio = sigmas, max_peak_ratio
        self.translation_sigma, self.translation_share = translation_sigma, translation_share
        self.rotation_sigma = math.radians(rotation_sigma_deg)
        self.rotation_share = rotation_share
        self._recent: deque[float] = deque(maxlen=history)

    def accept(self, result: RegistrationResult) -> None:
        self._recent.append(result.fitness)

    def reject(self, result: RegistrationResult, T_guess: Array) -> str | None:
        poor = self.reject_first(result, T_guess)
        if poor is not None:
            return poor
        off, turned = apart(T_guess, result.T_target_source)
        distance, turn = float(translation_norm(T_guess)), float(rotation_angle(T_guess))
        sigma = self.translation_sigma + self.translation_share * distance
        if off > self.sigmas * sigma:
            return f"{off:.2f} m from the guess, {off / sigma:.1f} sigmas"
        sigma = self.rotation_sigma + self.rotation_share * turn
        if turned > self.sigmas * sigma:
            return f"{math.degrees(turned):.0f} deg from the guess, {turned / sigma:.1f} sigmas"
        return None

    def reject_first(self, result: RegistrationResult, T_guess: Array) -> str | None:
        if result.converged is False:
            return "not converged"
        if result.fitness < self.min_fitness:
            return f"fitness {result.fitness:.2f} < {self.min_fitness:g}"
        if len(self._recent) >= FEWEST and self.usual > 0.0:
            usual = median(self._recent)
            if result.fitness < self.usual * usual:
                return f"fitness {result.fitness:.2f}, usually {usual:.2f}"
        held = result.localizability
        if self.min_localizability > 0.0 and held is not None:
            least = float(held.axes[0][0])
            if least < self.min_localizability:
                return f"localizability {least:.3g} < {self.min_localizability:g}"
        ratio = result.search_peak_ratio
        if ratio is not None and ratio >= self.max_peak_ratio:
            return f"a second peak of {ratio:.2f} of the best"
        return None
