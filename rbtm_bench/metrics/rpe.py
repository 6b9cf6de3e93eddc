"""Relative pose error: how far the estimated motion over some frames is from the true one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar

from annotated_types import Ge

from rbtm_bench.core.column import Column
from rbtm_bench.core.columns import family
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.datasets.base import Relations
from rbtm_bench.metrics.base import Metric, Values, paired


class Rpe(Metric):
    """RPE over motions of ``delta`` frames: E = inv(inv(G_i) G_j) inv(T_i) T_j, j = i + delta.

    Frames are the poses with a truth. By default the motions follow one another (i = 0, delta,
    2 delta, ...); with ``all_pairs`` they start at every frame and overlap. Nothing is aligned:
    the world frames cancel. A ``delta`` beyond the last frame gives None.
    """

    columns: ClassVar[Mapping[str, Column]] = family("rpe")

    def __init__(self, delta: Annotated[int, Ge(1)] = 1, all_pairs: bool = False) -> None:
        self.delta = delta
        self.all_pairs = all_pairs

    def evaluate(
        self, estimate: Trajectory, truth: Trajectory | None, relations: Relations | None = None
    ) -> Values:
        """See ``Metric.evaluate``; ``relations`` are not used."""
        pair = paired(estimate, truth)
        if pair is None:
            return self.nothing()

        from evo.core.filters import FilterException
        from evo.core.metrics import RPE, PoseRelation, StatisticsType
        from evo.core.trajectory import PosePath3D
        from evo.core.units import Unit

        path, reference = (PosePath3D(poses_se3=list(T)) for T in pair)
        wanted = {
            "rpe_translation_rmse_m": PoseRelation.translation_part,
            "rpe_rotation_rmse_deg": PoseRelation.rotation_angle_deg,
        }
        values: Values = {}
        for key, relation in wanted.items():
            rpe = RPE(relation, self.delta, Unit.frames, all_pairs=self.all_pairs)
            try:
                rpe.process_data((reference, path))
            except FilterException:
                return self.nothing()
            values[key] = float(rpe.get_statistic(StatisticsType.rmse))
        return values
