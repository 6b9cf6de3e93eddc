"""What a metric is: a handful of named numbers about one trajectory."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Container, Mapping
from typing import ClassVar

import numpy as np

from rbtm_bench.core.column import Column
from rbtm_bench.core.errors import DataError, one_line
from rbtm_bench.core.trajectory import Mask, Trajectory, orthonormalised
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.base import Dataset, Relations

Values = dict[str, float | int | None]
"""Metric key -> value; None says that the number does not exist."""

MIN_POSES = 2
"""Fewer poses hold no motion: with the first pose aligned every error would be a hollow 0."""

RIGID_TOLERANCE = 1e-6
"""How far from orthonormal a rotation may be once rounding errors are removed."""


class Metric(ABC):
    """A family of numbers about an estimated trajectory.

    ``columns`` declares every key (ours: ``core.columns``; a plug-in's own may be just
    "unit; definition; source"): ``evaluate`` gives all of them, always. A number that does not
    exist is None, never 0.
    """

    columns: ClassVar[Mapping[str, Column | str]]

    @abstractmethod
    def evaluate(
        self, estimate: Trajectory, truth: Trajectory | None, relations: Relations | None
    ) -> Values:
        """Compare ``estimate`` with what is known.

        ``truth`` has the length and order of ``estimate`` and matrices of NaN where it is not
        known, or is None; ``relations`` is None where there are none. A pose of NaN in the
        estimate (a scan that got none) is left out like a missing truth. Raises ``DataError`` if
        the lengths differ or a pose is not a rigid motion.
        """

    def nothing(self) -> Values:
        """Every key of this metric with None."""
        return dict.fromkeys(self.columns)


class ScanMetric(Metric):
    """A metric that looks at the scans as well; alone with trajectories it knows nothing."""

    def evaluate(
        self, estimate: Trajectory, truth: Trajectory | None, relations: Relations | None = None
    ) -> Values:
        """Every key with None: without scans there is nothing to measure."""
        return self.nothing()

    @abstractmethod
    def evaluate_scans(
        self, estimate: Trajectory, truth: Trajectory | None, dataset: Dataset
    ) -> Values:
        """As ``evaluate``, with the data set whose scans the poses of ``estimate`` belong to, in
        order. Raises ``DataError`` if their numbers differ."""


def evaluated(
    metric: Metric,
    estimate: Trajectory,
    truth: Trajectory | None,
    dataset: Dataset,
    taken: Container[str] = (),
) -> Values:
    """What a metric makes of a run, whether or not it needs the scans.

    Raises ``ValueError``, naming it, for keys that it has not declared or that are ``taken``, and
    for what is no finite number.
    """
    if isinstance(metric, ScanMetric):
        values = metric.evaluate_scans(estimate, truth, dataset)
    else:
        values = metric.evaluate(estimate, truth, dataset.relations)
    name = type(metric).__name__
    for key, value in values.items():
        if key not in metric.columns or key in taken:
            raise ValueError(f"{name}: {one_line(key)} is not a column of its own")
        real = isinstance(value, int | float) and math.isfinite(value)
        if value is not None and not real:
            raise ValueError(f"{name}: {key} is {one_line(value)}: expected a number or None")
    return values


def paired(estimate: Trajectory, truth: Trajectory | None) -> tuple[Array, Array] | None:
    """The poses (M, 4, 4) of estimate and truth where both are known, or None if M < 2.

    Matched by index. Rotations are orthonormalised, because truth is often stored with few
    digits and evo refuses relative rotations that are off by 1e-6. Raises ``DataError`` if the
    lengths differ or a pose is not a rigid motion.
    """
    if truth is None:
        return None
    if len(truth) != len(estimate):
        raise DataError(f"the truth has {len(truth)} poses and the estimate {len(estimate)}")
    known = estimate.known & truth.known
    if known.sum() < MIN_POSES:
        return None
    return _rigid(estimate, known, "estimate"), _rigid(truth, known, "truth")


def _rigid(trajectory: Trajectory, known: Mask, name: str) -> Array:
    """The known poses (M, 4, 4), free of rounding errors; ``DataError`` if one is no motion."""
    T = orthonormalised(trajectory.T_world_scan[known])
    R = T[:, :3, :3]
    off = np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max(axis=(1, 2))
    good = (off <= RIGID_TOLERANCE) & (np.linalg.det(R) > 0)
    if not good.all():
        index = np.flatnonzero(known)[~good][0]
        raise DataError(f"pose {index} of the {name} is not a rigid motion")
    return T
