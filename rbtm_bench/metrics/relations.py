"""The relation error of Kuemmerle et al. 2009, "On measuring the accuracy of SLAM algorithms".

It compares motions between pairs of times with motions known by hand (or otherwise), so it needs
no true trajectory and no common frame, and an error is counted where it arises.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Gt

from rbtm_bench.core.column import Column
from rbtm_bench.core.columns import family
from rbtm_bench.core.geometry import inverse, rotation_angle, translation_norm
from rbtm_bench.core.trajectory import Mask, Trajectory
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.association import nearest
from rbtm_bench.datasets.base import Relations
from rbtm_bench.metrics.base import Metric, Values
from rbtm_bench.metrics.relation_errors import RelationErrors


class RelationError(Metric):
    """Error E = inv(T_start_end) inv(T_i) T_j of the estimated motion between related times.

    An end of a relation is matched to the pose nearest in time, if within ``tolerance_s`` (s). The
    default 1e-4 s is 20 times the largest rounding between the time stamps of the public logs and
    their relations (5e-6 s, MIT CSAIL; 0 on ACES and Intel) and below the distance of any end to
    the next other scan (2.7e-4 s, Intel), so a scan that has no pose is never stood in for by its
    neighbour. Relations with an unmatched end are not used. ``local_s`` (s) splits by the time
    between the ends, in either direction: long ones span loops and carry nearly all of the mean.

    With no relations every key is None; with relations the counts are numbers, and the errors of
    a group without a used relation are None.
    """

    columns: ClassVar[Mapping[str, Column]] = family("relations")

    def __init__(
        self,
        tolerance_s: Annotated[float, Gt(0)] = 1e-4,
        local_s: Annotated[float, Ge(0)] = 30.0,
    ) -> None:
        self.tolerance_s = tolerance_s
        self.local_s = local_s

    def evaluate(
        self,
        estimate: Trajectory,
        truth: Trajectory | None = None,
        relations: Relations | None = None,
    ) -> Values:
        """See ``Metric.evaluate``; ``truth`` is not used."""
        if relations is None or len(relations) == 0:
            return self.nothing()
        errors = self.errors(estimate, relations)
        local = errors.local
        groups = {"": np.ones_like(local), "local_": local, "long_": ~local}
        values: Values = {}
        for name, group in groups.items():
            prefix, inside = f"relations_{name}", group & errors.used
            values |= _counts(prefix, group, errors.used)
            values |= _spread(f"{prefix}translation", "m", errors.translation_m[inside])
            values |= _spread(f"{prefix}rotation", "deg", errors.rotation_deg[inside])
        return values

    def errors(self, estimate: Trajectory, relations: Relations) -> RelationErrors:
        """The error of every relation, NaN for one with an unmatched end."""
        known = estimate.known
        stamps, T = estimate.stamps[known], estimate.T_world_scan[known]
        i = nearest(stamps, relations.start, self.tolerance_s)
        j = nearest(stamps, relations.end, self.tolerance_s)
        used = (i >= 0) & (j >= 0)
        E = inverse(relations.T_start_end[used]) @ inverse(T[i[used]]) @ T[j[used]]
        translation, rotation = np.full((2, len(relations)), np.nan)
        translation[used], rotation[used] = translation_norm(E), np.degrees(rotation_angle(E))
        local = np.abs(relations.end - relations.start) <= self.local_s
        return RelationErrors(relations.start, relations.end, local, translation, rotation)


def _counts(prefix: str, group: Mask, used: Mask) -> Values:
    return {f"{prefix}used": int((group & used).sum()), f"{prefix}total": int(group.sum())}


def _spread(prefix: str, unit: str, errors: Array) -> Values:
    """Mean and population standard deviation of the errors (M,), None without any."""
    some = len(errors) > 0
    return {
        f"{prefix}_mean_{unit}": float(errors.mean()) if some else None,
        f"{prefix}_std_{unit}": float(errors.std()) if some else None,
    }
