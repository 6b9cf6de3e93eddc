"""How far off the last pose is: the measure of Table I of the RBTM paper, taken apart."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Gt

from rbtm_bench.core.column import Column
from rbtm_bench.core.columns import family
from rbtm_bench.core.geometry import inverse, rotation_angle, yaw
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.base import Relations
from rbtm_bench.metrics.base import Metric, Values, paired

PLANAR_TOLERANCE = 1e-6
"""m and rad by which a motion may leave the plane z = 0 of the first pose and count as planar."""


class FinalPose(Metric):
    """The error of the last pose, with the first poses made equal and nothing fitted.

    Both trajectories are taken relative to their own first pose. ``travel_m`` (m): the true
    direction of travel at the end is the direction to the last true position from the latest one
    at least this far from it; long enough that noise in the truth does not decide it.
    """

    columns: ClassVar[Mapping[str, Column]] = family("final_pose")

    def __init__(self, travel_m: Annotated[float, Gt(0)] = 0.05) -> None:
        self.travel_m = travel_m

    def evaluate(
        self, estimate: Trajectory, truth: Trajectory | None, relations: Relations | None = None
    ) -> Values:
        """See ``Metric.evaluate``; ``relations`` are not used.

        The last pose is the last one known on both sides, the first likewise.
        """
        pair = paired(estimate, truth)
        if pair is None:
            return self.nothing()
        E, G = (inverse(T[0]) @ T for T in pair)
        error = E[-1, :3, 3] - G[-1, :3, 3]
        distance = float(np.linalg.norm(error))
        length = float(np.linalg.norm(np.diff(G[:, :3, 3], axis=0), axis=1).sum())
        off = inverse(G[-1]) @ E[-1]
        along, cross = self._split(error, G[:, :3, 3], planar=_is_planar(E) and _is_planar(G))
        return {
            "final_translation_error_mm": 1e3 * distance,
            "final_along_mm": along,
            "final_cross_mm": cross,
            "final_rotation_error_deg": float(np.degrees(rotation_angle(off))),
            "final_heading_error_deg": float(np.degrees(yaw(off))),
            "drift_percent": 100.0 * distance / length if length > 0 else None,
        }

    def _split(
        self, error: Array, positions: Array, planar: bool
    ) -> tuple[float, float] | tuple[None, None]:
        """Along and cross part in mm of the error (3,) m, given the true positions (M, 3) m."""
        away = np.linalg.norm(positions - positions[-1], axis=1)
        far = np.flatnonzero(away >= self.travel_m)
        if len(far) == 0:
            return None, None
        direction = (positions[-1] - positions[far[-1]]) / away[far[-1]]
        along = float(direction @ error)
        if planar:
            cross = float(direction[0] * error[1] - direction[1] * error[0])
        else:
            cross = float(np.linalg.norm(error - along * direction))
        return 1e3 * along, 1e3 * cross


def _is_planar(T: Array) -> bool:
    """Whether motions (M, 4, 4) stay in z = 0 and turn about z alone."""
    out_of_plane = np.concatenate([T[:, 2, :2].ravel(), T[:, 2, 3]])
    return bool(np.abs(out_of_plane).max() <= PLANAR_TOLERANCE)
