"""The paper's own descriptor and score, equations (1) to (3), literally.

It drowns in range noise: the difference of two neighbouring beams' points is mostly noise. And a
wall at phi = pi/2 jumps to -pi/2 by rounding alone (see docs/similarity.md for the figures).
``curvature_circular`` mends both.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.similarity.base import Descriptor, PairwiseSimilarity, require_beams
from rbtm_bench.similarity.inner import inner

NEGLIGIBLE_VARIANCE = 1e-12
"""rad^2: below this the angles of a scan are equal to within rounding."""


class Curvature(PairwiseSimilarity):
    """phi_i = atan((y_{i+1} - y_{i-1}) / (x_{i+1} - x_{i-1})) and the correlation coefficient.

    Where the paper is silent: N beams give N - 2 values; dx = 0 gives +-pi/2 with the sign of dy;
    a beam whose neighbours have no return (or coincide) has no value and is left out pairwise;
    a score over less than ``min_valid_share`` of the values, or with no variance, is NaN.
    """

    def __init__(self, min_valid_share: Annotated[float, Ge(0), Le(1)] = 0.5) -> None:
        self.min_valid_share = min_valid_share

    def check(self, dataset: Dataset) -> None:
        require_beams(dataset, "curvature")

    def describe(self, scan: Scan) -> Array:
        """phi (B - 2,) in rad, NaN where undefined."""
        assert scan.ranges is not None and scan.angles is not None
        x = scan.ranges * np.cos(scan.angles)
        y = scan.ranges * np.sin(scan.angles)
        dx, dy = x[2:] - x[:-2], y[2:] - y[:-2]
        with np.errstate(divide="ignore", invalid="ignore"):
            # + 0.0 turns -0.0 into 0.0, so that dx = 0 takes the sign of dy alone
            return np.arctan(dy / (dx + 0.0))

    def curve(self, descriptor: Descriptor) -> tuple[str, Array]:
        return "phi (deg)", np.degrees(descriptor)

    def pair_scores(self, rows: Descriptor, columns: Descriptor) -> Array:
        """Equation (3) over the values that both scans have."""
        x, x_known = _zero_unknown(rows)
        y, y_known = _zero_unknown(columns)
        shared = inner(x_known, y_known)
        sum_x, sum_y = inner(x, y_known), inner(x_known, y)
        with np.errstate(divide="ignore", invalid="ignore"):
            cov = (inner(x, y) - sum_x * sum_y / shared) / shared
            var_x = (inner(x * x, y_known) - sum_x**2 / shared) / shared
            var_y = (inner(x_known, y * y) - sum_y**2 / shared) / shared
            score = cov / np.sqrt(var_x * var_y)
        defined = (
            (shared >= max(2.0, self.min_valid_share * rows.shape[-1]))
            & (var_x > NEGLIGIBLE_VARIANCE)
            & (var_y > NEGLIGIBLE_VARIANCE)
        )
        return np.where(defined, np.clip(score, -1.0, 1.0), np.nan)


def _zero_unknown(phi: Descriptor) -> tuple[Array, Array]:
    """phi with 0 for NaN, and 1.0 where it was known."""
    known = np.isfinite(phi)
    return np.where(known, phi, 0.0), known.astype(np.float64)
