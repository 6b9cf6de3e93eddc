"""Correlative search in a window around the guess (Olson 2009)."""

from __future__ import annotations

import math
from typing import Annotated

from annotated_types import Ge, Gt, Le

from rbtm_bench.backends.base import Prepared
from rbtm_bench.backends.correlative import CorrelativeMatcher
from rbtm_bench.core.geometry import inverse, se2, yaw
from rbtm_bench.core.types import Array
from rbtm_bench.search.base import Search, Start

Positive = Annotated[float, Gt(0)]
Share = Annotated[float, Ge(0), Le(1)]


class CorrelativeSearch(Search):
    """The likeliest of all poses in a window around the guess: the search of ``csm_2d``, exact to
    its cells, for a local method to start from (Olson, ICRA 2009; Hess et al., ICRA 2016).

    The window reaches ``translation`` m and ``rotation_deg`` to either side, and ``sigmas``
    standard deviations of the guess more: ``translation_noise`` of the distance and
    ``rotation_noise`` of the turn between the two scans. A pose that scores less than
    ``min_gain`` above the guess is not believed to be better: the start is the guess. Where no
    pose of the window scores ``doubt`` (0: never asked), as after wheels that slipped, the
    window reaches ``wide_translation`` m and ``wide_rotation_deg`` further, and a pose out
    there is believed that scores ``wide_gain`` more. ``cell_size`` and ``sigma`` (m) are the
    table's. With ``peak_apart`` m the score of the best pose that far (or ``peak_apart_deg``)
    from the best is looked for as well, which costs several times the search: a share near 1
    says that the scans fit in two ways, 0 that the window holds no other pose.
    """

    dimensions = ("2d",)

    def __init__(
        self,
        translation: Annotated[float, Ge(0)] = 0.1,
        rotation_deg: Annotated[float, Ge(0), Le(180)] = 2.0,
        sigmas: Annotated[float, Ge(0)] = 2.0,
        translation_noise: Annotated[float, Ge(0)] = 0.1,
        rotation_noise: Annotated[float, Ge(0)] = 0.1,
        min_gain: Share = 0.05,
        doubt: Share = 0.0,
        wide_translation: Annotated[float, Ge(0)] = 0.5,
        wide_rotation_deg: Annotated[float, Ge(0), Le(180)] = 20.0,
        wide_gain: Share = 0.1,
        cell_size: Positive = 0.05,
        sigma: Positive = 0.1,
        peak_apart: Positive | None = None,
        peak_apart_deg: Positive = 10.0,
    ) -> None:
        self.translation, self.rotation = translation, math.radians(rotation_deg)
        self.by_distance, self.by_turn = sigmas * translation_noise, sigmas * rotation_noise
        self.min_gain, self.doubt, self.wide_gain = min_gain, doubt, wide_gain
        self.wider = wide_translation, math.radians(wide_rotation_deg)
        self.matcher = CorrelativeMatcher(cell_size, sigma, peak_apart or 0.0, peak_apart_deg)

    def start(self, source: Prepared, target: Prepared, T_target_source: Array) -> Start:
        distance = math.hypot(T_target_source[0, 3], T_target_source[1, 3])
        translation = self.translation + self.by_distance * distance
        rotation = self.rotation + self.by_turn * abs(float(yaw(T_target_source)))
        built, guess = target.as_built(T_target_source)  # its field is kept
        peak = self.matcher.match(source, built, guess, translation, rotation)
        if peak.score < self.doubt:
            further, turn = self.wider
            wide = self.matcher.match(source, built, guess, translation + further, rotation + turn)
            peak = wide if wide.score >= peak.score + self.wide_gain else peak
        if peak.score == 0.0 or peak.score < peak.middle_score + self.min_gain:
            return Start(T_target_source, peak.middle_score, peak.peak_ratio)
        pose = se2(*peak.pose)
        if built is not target:
            pose = T_target_source @ inverse(guess) @ pose
        return Start(pose, peak.score, peak.peak_ratio)
