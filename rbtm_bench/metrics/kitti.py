"""KITTI's segment errors and the fitted trajectory error, as KISS-ICP computes them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

from rbtm_bench.core.column import Column
from rbtm_bench.core.columns import family
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.datasets.base import Relations
from rbtm_bench.metrics.ape import is_collinear
from rbtm_bench.metrics.base import Metric, Values, paired

_FITTED = "kiss_icp.metrics.absolute_trajectory_error"


class KittiErrors(Metric):
    """Mean error over segments of 100, 200, ... 800 m of the true path, relative to their length.

    Segments start at every tenth pose with a truth and end at the first pose beyond their length,
    so a path of 100 m or less has none: then both keys are None. The numbers are KISS-ICP's own, in
    single precision; it turns radians into degrees with 3.14: the rotation is 0.05% too large.

    Beside them, what KISS-ICP prints as absolute trajectory error: the root mean squares of
    distances and rotation angles after the best rigid fit of the positions (Umeyama 1991, without
    scale). None where they leave the fitted rotation open: on a straight line, or in one place.
    """

    columns: ClassVar[Mapping[str, Column]] = family("kitti")

    def evaluate(
        self, estimate: Trajectory, truth: Trajectory | None, relations: Relations | None = None
    ) -> Values:
        """See ``Metric.evaluate``; ``relations`` are not used."""
        pair = paired(estimate, truth)
        if pair is None:
            return self.nothing()
        path, reference = pair

        from kiss_icp.metrics import absolute_trajectory_error, sequence_error

        translation, rotation = sequence_error(reference, path)
        values = self.nothing()
        if not math.isnan(translation):  # what it says without a segment
            values["kitti_translation_percent"] = float(translation)
            values["kitti_rotation_deg_per_m"] = float(rotation)
        if not is_collinear(path, reference):
            angle, distance = absolute_trajectory_error(reference, path)
            values["ate_translation_m"] = float(distance)
            values["ate_rotation_deg"] = math.degrees(angle)
        return values
