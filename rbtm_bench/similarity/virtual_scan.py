"""RBTM in 3D: a cloud's height band seen as a laser scan, then ``curvature_circular``."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.similarity.base import Descriptor
from rbtm_bench.similarity.curvature_circular import CurvatureCircular


class VirtualScan(CurvatureCircular):
    """Nearest return in each of ``bins`` azimuth bins among points with
    ``min_height_m`` <= z < ``max_height_m`` (sensor frame), compared by ``CurvatureCircular``,
    whose parameters it takes too. Lags are searched by default, because a vehicle's clouds turn by
    several bins from one to the next. A bin without a point is a beam with no return.
    """

    def __init__(
        self,
        min_height_m: float = -0.5,
        max_height_m: float = 0.5,
        bins: Annotated[int, Ge(16)] = 360,
        half_span_deg: Annotated[float, Gt(0), Le(45)] = 5.0,
        max_lag_deg: Annotated[float, Ge(0), Le(180)] = 10.0,
        lag_phase: Literal["consistent", "free"] = "consistent",
        center: bool = False,
        min_valid_share: Annotated[float, Ge(0), Le(1)] = 0.5,
        min_variance: Annotated[float, Ge(0), Le(1)] = 0.05,
    ) -> None:
        super().__init__(
            half_span_deg, max_lag_deg, lag_phase, center, min_valid_share, min_variance
        )
        if max_height_m <= min_height_m:
            raise ConfigError(
                f"similarity.max_height_m={max_height_m}: expected more than "
                f"min_height_m={min_height_m}"
            )
        self.min_height_m, self.max_height_m, self.bins = min_height_m, max_height_m, bins
        width = 2 * np.pi / bins
        self._angles: Array = np.asarray(-np.pi + width * (np.arange(bins) + 0.5), np.float64)

    def check(self, dataset: Dataset) -> None:
        if dataset.planar:
            raise ConfigError(
                "similarity=virtual_scan reads 3D clouds; this data set is planar: "
                "use similarity=curvature_circular"
            )

    def describe(self, scan: Scan) -> Descriptor:
        return self.describe_beams(self.project(scan.points), self._angles)

    def project(self, points: Array) -> Array:
        """Ranges (bins,) in m of the nearest points (N, 3) of the height band, NaN if none."""
        height = points[:, 2]
        band = points[(height >= self.min_height_m) & (height < self.max_height_m)]
        azimuth = np.arctan2(band[:, 1], band[:, 0])
        index = np.floor((azimuth + np.pi) * (self.bins / (2 * np.pi))).astype(np.int64)
        ranges = np.full(self.bins, np.inf)
        np.minimum.at(ranges, index % self.bins, np.hypot(band[:, 0], band[:, 1]))
        ranges[~np.isfinite(ranges)] = np.nan
        return ranges
