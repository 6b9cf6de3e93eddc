"""Absolute pose error: how far the estimated positions are from the true ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import numpy as np

from rbtm_bench.core.column import Column
from rbtm_bench.core.columns import family
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.base import Relations
from rbtm_bench.metrics.base import Metric, Values, paired

RANK_TOLERANCE = 1e-12
"""Ratio of the second to the first singular value below which positions count as collinear."""


class Ape(Metric):
    """APE of the positions after an alignment, over all poses with a truth.

    ``align``: "none" compares in the given world frames; "origin" makes the first poses equal;
    "umeyama" fits the whole trajectory by a rigid motion, without scale (Umeyama 1991). Positions
    on one straight line, or all in one place, leave the fitted rotation open: then every key is
    None.
    """

    columns: ClassVar[Mapping[str, Column]] = family("ape")

    def __init__(self, align: Literal["none", "origin", "umeyama"] = "origin") -> None:
        self.align = align

    def evaluate(
        self, estimate: Trajectory, truth: Trajectory | None, relations: Relations | None = None
    ) -> Values:
        """See ``Metric.evaluate``; ``relations`` are not used."""
        ape = self._processed(estimate, truth)
        if ape is None:
            return self.nothing()

        from evo.core.metrics import StatisticsType

        return {
            "ape_rmse_m": float(ape.get_statistic(StatisticsType.rmse)),
            "ape_mean_m": float(ape.get_statistic(StatisticsType.mean)),
            "ape_max_m": float(ape.get_statistic(StatisticsType.max)),
        }

    def distances(self, estimate: Trajectory, truth: Trajectory | None) -> Array | None:
        """The distances (M,) m that the statistics are of, one a pose that is known on both
        sides; None where they are None."""
        ape = self._processed(estimate, truth)
        return None if ape is None else np.asarray(ape.error, dtype=np.float64)

    def _processed(self, estimate: Trajectory, truth: Trajectory | None) -> Any:
        """evo's APE of the aligned positions, None where it is undefined."""
        pair = paired(estimate, truth)
        if pair is None or (self.align == "umeyama" and is_collinear(*pair)):
            return None

        from evo.core.geometry import GeometryException
        from evo.core.metrics import APE
        from evo.core.trajectory import PosePath3D

        path, reference = (PosePath3D(poses_se3=list(T)) for T in pair)
        if self.align == "origin":
            path.align_origin(reference)
        elif self.align == "umeyama":
            try:
                path.align(reference)
            except GeometryException:
                return None
        ape = APE()
        ape.process_data((reference, path))
        return ape


def is_collinear(estimate: Array, truth: Array) -> bool:
    """Whether the fit of poses (M, 4, 4) to others leaves a rotation open.

    evo's own test holds the singular values against an absolute 2e-16, so on a long straight path
    rounding decides whether it raises. Relative to the largest it is always the same answer.
    """
    x, y = (T[:, :3, 3] - T[:, :3, 3].mean(axis=0) for T in (estimate, truth))
    singular = np.linalg.svd(y.T @ x, compute_uv=False)
    return bool(singular[1] <= RANK_TOLERANCE * singular[0])
