"""What every registration is judged by, the same for all backends: fitness, inlier RMSE, and
whether the matched surfaces hold the motion at all.

The loop, and whoever else registers a pair, calls ``register``: the backend's answer, judged.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.backends.base import Alignment, Backend, Prepared, checked_alignment
from rbtm_bench.backends.plane_index import plane_index
from rbtm_bench.backends.space_index import SpaceIndex, space_index
from rbtm_bench.core.geometry import symmetric, voxel_downsample
from rbtm_bench.core.rigid import all_finite, apart, rigidity, symmetric_information
from rbtm_bench.core.types import Array, Localizability, RegistrationResult
from rbtm_bench.odometry.judge_plane import MATRIX, MAX_MATCHES, MIN_SURFACE, plane_sums
from rbtm_bench.odometry.judge_space import space_matches, spreads

MIN_INLIERS = 3
"""With fewer inliers a plane motion is not determined: never called converged."""
MAX_POINTS = 4000
"""Points of a cloud in space that are judged, evenly spread over it."""
SURFACE_NEIGHBOURS = 20
"""Neighbours of a target point, at most, that its normal in space is computed from."""


class Evaluation(NamedTuple):
    """What ``evaluate`` finds: see ``RegistrationResult``."""

    fitness: float
    inlier_rmse: float
    inliers: int
    localizability: Localizability | None


def register(
    backend: Backend,
    source: Prepared,
    target: Prepared,
    T_target_source: Array,
    most: int = MAX_POINTS,
    radius: float | None = None,
) -> RegistrationResult:
    """The backend's registration from the initial guess ``T_target_source`` (4, 4), judged within
    ``radius`` m (None: the backend's ``max_correspondence_distance``) by at most ``most`` points of
    a cloud in space.

    ``converged`` is False, whatever the library says, when fewer than 3 source points lie within
    that radius of the target. Raises as ``Backend.register``.
    """
    compile_kernels()
    alignment = backend.register(source, target, T_target_source)
    if type(backend).register is not Backend.register:  # of its own making: looked at as well
        alignment = checked_alignment(backend, alignment, source.planar and target.planar)
    if radius is None:
        radius = backend.max_correspondence_distance
    return judged(alignment, source, target, radius, most)


def judged(
    alignment: Alignment,
    source: Prepared,
    target: Prepared,
    radius: float,
    most: int = MAX_POINTS,
) -> RegistrationResult:
    """What a library says of a registration, and what we find within ``radius`` m."""
    evaluation = evaluate(source, target, alignment.T_target_source, radius, most)
    return RegistrationResult(
        T_target_source=alignment.T_target_source,
        converged=False if evaluation.inliers < MIN_INLIERS else alignment.converged,
        fitness=evaluation.fitness,
        inlier_rmse=evaluation.inlier_rmse,
        inliers=evaluation.inliers,
        iterations=alignment.iterations,
        seconds=alignment.seconds,
        information=alignment.information,
        library_fitness=alignment.library_fitness,
        library_rmse=alignment.library_rmse,
        localizability=evaluation.localizability,
        search_seconds=alignment.search_seconds,
        search_score=alignment.search_score,
        search_peak_ratio=alignment.search_peak_ratio,
    )


@cache
def compile_kernels() -> None:
    """Compile, or load from disk, what registering and judging call: never on a registration's
    time."""
    plane_sums(*plane_index(np.eye(3)), np.eye(3), np.eye(4), 9.0)
    cells = space_index(np.eye(3), 1.0)
    places, _ = space_matches(cells, np.eye(3), np.eye(4), 1.0, 1)
    spreads(cells, places, SURFACE_NEIGHBOURS)
    rigidity(np.eye(4))
    apart(np.eye(4), np.eye(4))
    symmetric_information(np.eye(6), True)
    all_finite(np.eye(3))
    voxel_downsample(np.eye(3), 1.0)


def evaluate(
    source: Prepared,
    target: Prepared,
    T_target_source: Array,
    radius: float,
    most: int = MAX_POINTS,
) -> Evaluation:
    """Fitness, inlier RMSE (m), inlier count and localizability.

    A source point is an inlier if its nearest target point is less than ``radius`` m away.
    Fitness is the share of inliers among source points (as in Open3D's
    ``evaluate_registration``). A target point's normal is the direction of least spread among its
    neighbours within ``radius``. Of a cloud in space every k-th point is looked at, so that at most
    ``most`` are; ``inliers`` is then k times those.
    """
    target, T_target_source = target.as_built(T_target_source)  # where its indexes are
    if target.planar:
        return _evaluate_2d(source, target, T_target_source, radius)
    step = max(1, -(-len(source.points) // most))
    index = target.cells(radius)
    places, squares = space_matches(index, source.points, T_target_source, radius, step)
    inlier = np.flatnonzero(places >= 0)
    count = len(inlier)
    rmse = math.sqrt(squares / count) if count else math.nan
    chosen = inlier[_spread(count)]
    held = _localizability_3d(source.points[chosen * step], index, places[chosen], T_target_source)
    return Evaluation(count / len(places), rmse, count * step, held)


def _evaluate_2d(source: Prepared, target: Prepared, T: Array, radius: float) -> Evaluation:
    sums = plane_sums(*target.index, source.points, T, radius)
    count, squares, used, lever = sums[:MATRIX].tolist()
    rmse = math.sqrt(squares / count) if count else math.nan
    held = Localizability(sums[MATRIX:].reshape(3, 3), lever) if used >= MIN_SURFACE else None
    return Evaluation(count / len(source.points), rmse, int(count), held)


def _spread(count: int) -> slice:
    """Every k-th of ``count`` items, so that at most ``MAX_MATCHES`` remain."""
    return slice(None, None, max(1, -(-count // MAX_MATCHES)))


def _localizability_3d(
    points: Array, index: SpaceIndex, places: NDArray[np.int64], T: Array
) -> Localizability | None:
    """Of matched source points (M, 3) and the places (M,) of their target points."""
    if len(points) < MIN_SURFACE:
        return None
    counts, spread = spreads(index, places, SURFACE_NEIGHBOURS)
    has_normal = counts >= MIN_SURFACE
    if has_normal.sum() < MIN_SURFACE:
        return None
    n = np.linalg.eigh(spread[has_normal])[1][:, :, 0] @ T[:3, :3]
    p = points[has_normal]
    lever = math.sqrt(float((p * p).sum(axis=1).mean())) or 1.0
    j = np.hstack([n, np.cross(p, n) / lever])
    return Localizability(symmetric(j.T @ j / len(j)), lever)
