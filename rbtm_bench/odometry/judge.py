"""What every registration is judged by, the same for all backends: fitness, inlier RMSE, and
whether the matched surfaces hold the motion at all.

The loop, and whoever else registers a pair, calls ``register``: the backend's answer, judged.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from rbtm_bench.backends.base import Alignment, Backend, Prepared, checked_alignment
from rbtm_bench.backends.neighbours_2d import Sorted2D, nearest_2d, sorted_2d, tangent_at
from rbtm_bench.core.geometry import symmetric, transform
from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.types import Array, Localizability, RegistrationResult

MIN_INLIERS = 3
"""With fewer inliers a plane motion is not determined: never called converged."""
MIN_SURFACE = 3
"""Fewer target points than this, the matched one included, have no normal."""
MAX_MATCHES = 200
"""Matched points, spread evenly over the inliers, that the localizability is computed from."""
SURFACE_NEIGHBOURS = 20
"""Neighbours of a target point, at most, that its normal in space is computed from."""


class Evaluation(NamedTuple):
    """What ``evaluate`` finds: see ``RegistrationResult``."""

    fitness: float
    inlier_rmse: float
    inliers: int
    localizability: Localizability | None


def register(
    backend: Backend, source: Prepared, target: Prepared, T_target_source: Array
) -> RegistrationResult:
    """The backend's registration from the initial guess ``T_target_source`` (4, 4), judged.

    ``converged`` is False, whatever the library says, when fewer than 3 source points lie within
    the backend's ``max_correspondence_distance`` of the target. Raises as ``Backend.register``.
    """
    compile_kernels()
    alignment = backend.register(source, target, T_target_source)
    if type(backend).register is not Backend.register:  # of its own making: looked at as well
        alignment = checked_alignment(backend, alignment, source.planar and target.planar)
    return judged(alignment, source, target, backend.max_correspondence_distance)


def judged(
    alignment: Alignment, source: Prepared, target: Prepared, radius: float
) -> RegistrationResult:
    """What a library says of a registration, and what we find within ``radius`` m."""
    evaluation = evaluate(source, target, alignment.T_target_source, radius)
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
    )


@cache
def compile_kernels() -> None:
    """Compile, or load from disk, what planar evaluation calls: never on a registration's time."""
    _planar_sums(sorted_2d(np.eye(3)), np.eye(3), 1.0, 0.0, 0.0, 0.0, 9.0)


def evaluate(
    source: Prepared, target: Prepared, T_target_source: Array, radius: float
) -> Evaluation:
    """Fitness, inlier RMSE (m), inlier count and localizability.

    A source point is an inlier if its nearest target point is less than ``radius`` m away.
    Fitness is the share of inliers among source points (as in Open3D's
    ``evaluate_registration``). A target point's normal is the direction of least spread among its
    neighbours within ``radius``.
    """
    if target.planar:
        return _evaluate_2d(source, target, T_target_source, radius)
    distance, match = target.tree.query(
        transform(T_target_source, source.points), distance_upper_bound=radius
    )
    inlier = np.flatnonzero(distance < np.inf)
    count = len(inlier)
    matched = distance[inlier]
    rmse = math.sqrt(np.dot(matched, matched) / count) if count else math.nan
    chosen = inlier[_spread(count)]
    held = _localizability_3d(source.points[chosen], target, match[chosen], T_target_source, radius)
    return Evaluation(count / len(source.points), rmse, count, held)


def _evaluate_2d(source: Prepared, target: Prepared, T: Array, radius: float) -> Evaluation:
    xy = source.points
    count, squares, matrix, lever, used = _planar_sums(
        target.sorted, xy, T[0, 0], T[1, 0], T[0, 3], T[1, 3], radius
    )
    rmse = math.sqrt(squares / count) if count else math.nan
    held = Localizability(matrix, lever) if used >= MIN_SURFACE else None
    return Evaluation(count / len(xy), rmse, count, held)


@kernel
def _planar_sums(
    target: Sorted2D, source: Array, c: float, s: float, x: float, y: float, radius: float
) -> tuple[int, float, Array, float, int]:
    """Inliers, their squared distances, the matrix of ``Localizability``, its lever, and how many
    matches had a normal."""
    places = np.empty(len(source), dtype=np.int64)
    count, squares = 0, 0.0
    for i in range(len(source)):
        px, py = source[i, 0], source[i, 1]
        place, distance = nearest_2d(target, c * px - s * py + x, s * px + c * py + y, radius)
        places[i] = place
        if place >= 0:
            count += 1
            squares += distance * distance
    step = max(1, -(-count // MAX_MATCHES))
    H = np.zeros((3, 3))
    seen, used, lever = 0, 0, 0.0
    for i in range(len(source)):
        if places[i] < 0:
            continue
        seen += 1
        if (seen - 1) % step:
            continue
        neighbours, tangent = tangent_at(target, places[i], radius)
        if neighbours < MIN_SURFACE:
            continue
        used += 1
        nx, ny = -np.sin(tangent), np.cos(tangent)
        u, v = c * nx + s * ny, c * ny - s * nx  # the normal in the source's frame
        px, py = source[i, 0], source[i, 1]
        r = px * v - py * u
        lever += px * px + py * py
        H[0, 0] += u * u
        H[0, 1] += u * v
        H[1, 1] += v * v
        H[0, 2] += u * r
        H[1, 2] += v * r
        H[2, 2] += r * r
    if used == 0:
        return count, squares, H, 1.0, 0
    lever = np.sqrt(lever / used) or 1.0
    H /= used
    H[:2, 2] /= lever
    H[2, 2] /= lever * lever
    H[1, 0], H[2, 0], H[2, 1] = H[0, 1], H[0, 2], H[1, 2]
    return count, squares, H, lever, used


def _spread(count: int) -> slice:
    """Every k-th of ``count`` items, so that at most ``MAX_MATCHES`` remain."""
    return slice(None, None, max(1, -(-count // MAX_MATCHES)))


def _localizability_3d(
    points: Array, target: Prepared, match: Any, T: Array, radius: float
) -> Localizability | None:
    """Of matched source points (M, 3) and the numbers (M,) of their target points."""
    if len(points) < MIN_SURFACE:
        return None
    count = min(SURFACE_NEIGHBOURS, len(target.points))
    distance, index = target.tree.query(target.points[match], k=count, distance_upper_bound=radius)
    inside = distance < np.inf
    neighbours = target.points[np.where(inside, index, 0)]
    total = inside.sum(axis=1)
    weight = inside[..., None] / np.maximum(total, 1)[:, None, None]
    offset = neighbours - (neighbours * weight).sum(axis=1, keepdims=True)
    spread = np.einsum("mki,mkj->mij", offset * weight, offset)
    has_normal = total >= MIN_SURFACE
    if has_normal.sum() < MIN_SURFACE:
        return None
    n = np.linalg.eigh(spread[has_normal])[1][:, :, 0] @ T[:3, :3]
    p = points[has_normal]
    lever = math.sqrt(float((p * p).sum(axis=1).mean())) or 1.0
    j = np.hstack([n, np.cross(p, n) / lever])
    return Localizability(symmetric(j.T @ j / len(j)), lever)
