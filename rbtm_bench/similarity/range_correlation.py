"""The correlation of two range profiles, beam with beam, over the rotations between them."""

from __future__ import annotations

import functools
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.similarity.base import (
    Descriptor,
    PairwiseSimilarity,
    beam_spacing,
    require_beams,
)
from rbtm_bench.similarity.inner import inner

NEGLIGIBLE_VARIANCE = 1e-6
"""m^2: below this (1 mm of deviation) the ranges are those of a circle around the sensor."""


class RangeCorrelation(PairwiseSimilarity):
    """The correlation coefficient of the ranges r over the beams that both scans have, the highest
    over lags of L beams: ``max over L of corr(r_j[b + L], r_k[b])``.

    A sensor turned by L beams sees the same ranges L beams later. Lags reach ``max_lag_deg`` to
    either side (0: none) and do not go around a full circle. A lag with fewer shared beams than
    ``min_valid_share`` of all, or with ranges that do not vary over them, does not count; a score
    without a lag that does is NaN. In [-1, 1]; symmetric.
    """

    def __init__(
        self,
        max_lag_deg: Annotated[float, Ge(0), Le(180)] = 10.0,
        min_valid_share: Annotated[float, Ge(0), Le(1)] = 0.5,
    ) -> None:
        self.max_lag_deg = max_lag_deg
        self.min_valid_share = min_valid_share
        self._spacing: float | None = None

    def check(self, dataset: Dataset) -> None:
        require_beams(dataset, "range_correlation")

    def describe(self, scan: Scan) -> Array:
        """(3 B,): ranges in m less their mean, their squares, and the mask; 0 for no return.

        Raises ``DataError`` if the spacing of the beams changes, or for a single beam.
        """
        assert scan.ranges is not None and scan.angles is not None
        self._spacing = beam_spacing(scan.angles, self._spacing, "range_correlation")
        known = np.isfinite(scan.ranges)
        # a correlation does not know a mean, but the sums of squares lose digits to it
        mean = scan.ranges[known].mean() if known.any() else 0.0
        ranges = np.where(known, scan.ranges - mean, 0.0)
        return np.concatenate([ranges, ranges * ranges, known])

    def curve(self, descriptor: Descriptor) -> tuple[str, Array]:
        ranges, _, known = descriptor.reshape(3, -1)
        return "range less its mean (m)", np.where(known > 0, ranges, np.nan)

    def pair_scores(self, rows: Descriptor, columns: Descriptor) -> Array:
        beams = rows.shape[-1] // 3
        most = 0
        if self.max_lag_deg > 0 and self._spacing:
            most = min(beams - 1, round(np.radians(self.max_lag_deg) / abs(self._spacing)))
        scores = (self._score(rows, columns, lag, beams) for lag in range(-most, most + 1))
        return functools.reduce(np.fmax, scores)

    def _score(self, rows: Descriptor, columns: Descriptor, lag: int, beams: int) -> Array:
        """Beam b + lag of the rows against beam b of the columns."""
        start, count = max(lag, 0), beams - abs(lag)
        x, xx, x_known = (rows[..., k * beams + start :][..., :count] for k in range(3))
        start = max(-lag, 0)
        y, yy, y_known = (columns[..., k * beams + start :][..., :count] for k in range(3))
        shared = inner(x_known, y_known)
        sum_x, sum_y = inner(x, y_known), inner(x_known, y)
        with np.errstate(divide="ignore", invalid="ignore"):
            cov = (inner(x, y) - sum_x * sum_y / shared) / shared
            var_x = (inner(xx, y_known) - sum_x * sum_x / shared) / shared
            var_y = (inner(x_known, yy) - sum_y * sum_y / shared) / shared
            score = cov / np.sqrt(var_x * var_y)
        defined = (
            (shared >= max(2.0, self.min_valid_share * beams))
            & (var_x > NEGLIGIBLE_VARIANCE)
            & (var_y > NEGLIGIBLE_VARIANCE)
        )
        return np.where(defined, np.clip(score, -1.0, 1.0), np.nan)
