"""How crisp the map is that a trajectory makes of its scans: no truth needed, and none replaced.

Put together by wrong poses a wall becomes thick or double, so its points scatter more, and over
more cells. But a map that collapsed, or flew apart, is crisp as well, so the same numbers of the
truth and of no motion at all go with them, and nothing is to be ranked by them alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Gt

from rbtm_bench.core.column import Column
from rbtm_bench.core.columns import family
from rbtm_bench.core.errors import DataError
from rbtm_bench.core.geometry import inverse, transform
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.metrics.base import MIN_POSES, ScanMetric, Values
from rbtm_bench.metrics.neighbourhoods import Integers, occupied_cells, scatter

RADIUS_M = {True: 0.3, False: 1.0}
"""The default, for planar scans and clouds. Of clouds with rings 0.3 m (the default of
Razlaw's program) sees little but single rings, and no motion at all is crisper than the truth."""

THINNEST_M = 1e-3
"""No neighbourhood counts as thinner than this, or a map without noise would have no entropy."""


class MapQuality(ScanMetric):
    """Entropy, thickness and size of the map of some scans, the same ones for every method.

    Around a point of the map lie the points within ``radius`` (m; None: 0.3 for planar scans, 1.0
    for clouds), itself included, with the covariance S (divided by their number); in 2D x and y
    alone count. Its entropy is
    ln det(2 pi e S) / 2; the means over points are the mean map entropy and, of the smallest
    eigenvalue of S, the mean line variance (2D) or plane variance (3D). Eigenvalues count as at
    least (1 mm)^2. A point with fewer than ``neighbours`` is left out; ``map_supported`` is the
    share of points that are not. Razlaw et al. 2015 measure a plane's variance at a plane fitted
    by RANSAC; the smallest eigenvalue (as Kornilov and Ferrer 2022) needs no random numbers.
    ``map_cells`` counts the cells of ``cell`` (m) that hold a point: squares in 2D, cubes in 3D.

    Time and memory are bounded by taking at most ``scans`` scans, spread evenly over those with a
    truth (all, if none has); of each at most ``points`` / ``scans`` points, spread evenly;
    and at most ``centres`` of all these, spread evenly, to look around. None of it depends on the
    estimate. The first pose is the identity for all, as the grid's place changes the count. Where
    one of these scans has no estimated pose every number of the estimate is None.
    """

    columns: ClassVar[Mapping[str, Column]] = family("maps")

    def __init__(
        self,
        radius: Annotated[float, Gt(0)] | None = None,
        neighbours: Annotated[int, Ge(4)] = 15,
        cell: Annotated[float, Gt(0)] = 0.05,
        scans: Annotated[int, Ge(MIN_POSES)] = 500,
        points: Annotated[int, Ge(1)] = 1_000_000,
        centres: Annotated[int, Ge(1)] = 10_000,
    ) -> None:
        self.radius = radius
        self.neighbours = neighbours
        self.cell = cell
        self.scans = scans
        self.points = points
        self.centres = centres

    def evaluate_scans(
        self, estimate: Trajectory, truth: Trajectory | None, dataset: Dataset
    ) -> Values:
        """See ``ScanMetric.evaluate_scans``."""
        if len(estimate) != len(dataset):
            raise DataError(f"{len(estimate)} poses for {len(dataset)} scans")
        where = np.arange(len(dataset))
        if truth is not None and truth.known.sum() >= MIN_POSES:
            where = np.flatnonzero(truth.known)
        where = where[_spread(len(where), self.scans)]
        if len(where) < MIN_POSES:
            return self.nothing()
        clouds = self._clouds(dataset, where)
        still = np.tile(np.eye(4), (len(where), 1, 1))
        paths = {"": estimate.T_world_scan[where], "_still": still}
        if truth is not None:
            paths["_truth"] = truth.T_world_scan[where]
        values = self.nothing()
        for end, T in paths.items():
            for key, value in self._measured(clouds, T, dataset.planar).items():
                values[key + end] = value
        return values

    def _clouds(self, dataset: Dataset, where: Integers) -> list[Array]:
        """The chosen points (M, 3) m of the chosen scans, in the sensor's frame."""
        most = max(1, self.points // len(where))
        clouds = (dataset[int(index)].points for index in where)
        return [points[_spread(len(points), most)] for points in clouds]

    def _measured(self, clouds: list[Array], T_world_scans: Array, planar: bool) -> Values:
        """The numbers of one map; none without a point or with a pose that is not known."""
        if not np.isfinite(T_world_scans).all() or not any(map(len, clouds)):
            return {}
        T_first_scans = inverse(T_world_scans[0]) @ T_world_scans
        placed = [transform(T, cloud) for T, cloud in zip(T_first_scans, clouds, strict=True)]
        points = np.concatenate(placed)[:, : 2 if planar else 3]
        values: Values = {"map_cells": occupied_cells(points, self.cell)}
        radius = RADIUS_M[planar] if self.radius is None else self.radius
        number, covariance = scatter(points, _spread(len(points), self.centres), radius)
        enough = number >= self.neighbours
        values["map_supported"] = float(enough.mean())
        if enough.any():
            variances = np.linalg.eigvalsh(covariance[enough]).clip(min=THINNEST_M**2)
            entropies = 0.5 * np.log(2.0 * np.pi * np.e * variances).sum(axis=1)
            values["map_entropy_nat"] = float(entropies.mean())
            values["map_variance_mm2"] = 1e6 * float(variances[:, 0].mean())
        return values


def _spread(count: int, most: int) -> Integers:
    """At most ``most`` of the numbers 0 ... count - 1, spread evenly, both ends among them."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).round().astype(np.int64)
