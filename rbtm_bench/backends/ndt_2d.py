"""Normal distributions transform in the plane (Biber and Strasser 2003): our own kernels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge, Gt, Le

from rbtm_bench.backends.base import Alignment, Backend, Prepared
from rbtm_bench.backends.ndt_2d_cells import Cells, cells_of, half_cell, place
from rbtm_bench.core.errors import BackendError, ConfigError
from rbtm_bench.core.geometry import se2, symmetric, yaw
from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.kinds import Distance, VoxelSize
from rbtm_bench.core.types import Array

Positive = Annotated[float, Gt(0)]

ARMIJO = 1e-4
"""Share of the increase promised by the gradient that a step must bring."""
HALVINGS = 12
"""How often a step is halved before it counts as nothing."""
FLAT = 1e-6
"""The Hessian's smallest eigenvalue is at least this part of its largest."""
NOTHING = 72.0
"""Squared Mahalanobis distance from which on exp(-d^2/2) is lost in rounding."""


class NdtSettings(NamedTuple):
    """When the optimisation stops."""

    max_iterations: int
    translation_epsilon: float
    rotation_epsilon: float


class NDT2D(Backend):
    """Biber and Strasser, "The Normal Distributions Transform", IROS 2003; our own code.

    The target becomes cells (section III): four grids with squares of ``cell_size`` m, shifted by
    half a cell; a cell of at least ``min_points`` has the mean and the covariance of its points,
    whose smaller eigenvalue is at least ``eigenvalue_ratio`` of the larger. The score (section IV)
    is the sum of exp(-q^T S^-1 q / 2) over source points and their four cells, q from the cell's
    mean to the moved point. Newton's method climbs to its maximum with the gradient and Hessian
    of section V. A Hessian that is not positive definite gets a multiple of the identity (rotation
    counted as the way it moves a point at the RMS range). Of ours: a step moves no point at that
    range farther than half a cell, and is halved until the score rises.

    ``cell_sizes`` (m) are gone through in order, coarse to fine; the paper has one, of 1 m. With
    [4, 2, 1] the motion may be farther from the guess, but slides farther along a corridor, too.
    ``max_iterations`` holds for each, ``translation_epsilon`` (m) and ``rotation_epsilon`` (rad)
    are the steps below which it stops. ``converged``: such a step, or none that raises the score;
    False after too many iterations, or where no point lies in a cell.
    ``max_correspondence_distance`` is the evaluator's radius only.

    The information is the Hessian of -score at the end, None if it is not positive. It needs no
    factor: a point spread like its cell adds a quarter of S^-1 for each of its four cells on
    average. Along a bare wall it stays about 10 /m^2 a point (with 1 m cells), since a cell ends.
    ``library_fitness`` is the score over its most, four for each point. Deterministic.
    """

    library = "our own (MIT)"
    converged_means = "last step below the epsilons, or none raises the score"
    repeats = "same bits; one thread"
    dimensions = ("2d",)
    self_tolerance = 0.01  # points are compared with cells

    def __init__(
        self,
        max_correspondence_distance: Distance = 0.3,
        voxel_size: VoxelSize = 0.0,
        cell_sizes: Sequence[Positive] = (1.0,),
        min_points: Annotated[int, Ge(2)] = 3,
        eigenvalue_ratio: Annotated[float, Gt(0), Le(1)] = 1e-3,
        max_iterations: Annotated[int, Ge(1)] = 50,
        translation_epsilon: Positive = 1e-4,
        rotation_epsilon: Positive = 1e-4,
    ) -> None:
        if len(cell_sizes) == 0:
            raise ConfigError("backend.cell_sizes=[]: expected at least one size")
        super().__init__(max_correspondence_distance, voxel_size)
        self.cell_sizes = [float(size) for size in cell_sizes]
        self.min_points = min_points
        self.eigenvalue_ratio = eigenvalue_ratio
        self.settings = NdtSettings(max_iterations, translation_epsilon, rotation_epsilon)
        corner = np.array([[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [0, 0.1, 0]], dtype=np.float64)
        tiny = Prepared(corner, True, self.build(corner, True))
        self.align(tiny, tiny, np.eye(4))  # compiles the kernels

    def build(self, points: Array, planar: bool) -> list[Cells]:
        if not planar:
            raise BackendError("ndt_2d registers planar scans only")
        least, ratio = self.min_points, self.eigenvalue_ratio
        return [cells_of(points, size, least, ratio) for size in self.cell_sizes]

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        T = T_target_source
        pose = np.array([T[0, 3], T[1, 3], float(yaw(T))])
        iterations, converged = 0, False
        terms = np.zeros(10)
        for cells in target.native:
            pose, terms, steps, converged = maximise(source.points, cells, pose, self.settings)
            iterations += steps
        return Alignment(
            se2(*pose),
            converged=converged,
            iterations=iterations,
            information=information(terms, pose[2]),
            library_fitness=terms[0] / (4 * len(source.points)),
        )


def information(terms: Array, theta: float) -> Array | None:
    """The Hessian of ``score_terms`` as the (6, 6) information of a motion in the source's frame,
    or None if it is not positive definite."""
    H = np.empty((3, 3))
    H[np.tril_indices(3)] = terms[4:]
    H[np.triu_indices(3)] = H.T[np.triu_indices(3)]
    A = se2(0.0, 0.0, theta)[:3, :3]  # turns x and y, keeps the rotation
    H = symmetric(A.T @ H @ A)
    if not np.linalg.eigvalsh(H)[0] > 0.0:
        return None
    out = np.zeros((6, 6))
    out[np.ix_([0, 1, 5], [0, 1, 5])] = H
    return out


@kernel
def score_terms(points: Array, cells: Cells, pose: Array) -> Array:
    """Score, its gradient and the Hessian of -score: (10,) = score, x, y, theta; xx, yx, yy, tx,
    ty, tt (lower triangle) for source points (N, 2 or 3) m moved by ``pose`` x, y, theta.

    Biber and Strasser, section V, with q = moved point - mean, A = S^-1, u = A q, s = exp(-q.u/2):
    gradient_i = -s u.dq_i, Hessian_ij = s (dq_i.A dq_j + u.ddq_ij - (u.dq_i)(u.dq_j)).
    """
    out = np.zeros(10)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for point in range(len(points)):
        rx = c * points[point, 0] - s * points[point, 1]
        ry = s * points[point, 0] + c * points[point, 1]
        x, y = rx + pose[0], ry + pose[1]
        at = place(cells.slots, half_cell(x, cells.size), half_cell(y, cells.size))
        half = cells.slots[at, 2]
        if half < 0:
            continue
        for quarter in range(4):
            row = cells.over[half, quarter]
            if row < 0:
                continue
            normal = cells.normals[row]
            qx, qy = x - normal[0], y - normal[1]
            ux, uy = normal[2] * qx + normal[3] * qy, normal[3] * qx + normal[4] * qy
            square = qx * ux + qy * uy
            if square > NOTHING:
                continue
            weight = math.exp(-0.5 * square)
            out[0] += weight
            # the point moves by (-ry, rx) per rad, and this turns towards (-rx, -ry)
            ut = rx * uy - ry * ux
            ax, ay = normal[3] * rx - normal[2] * ry, normal[4] * rx - normal[3] * ry
            out[1] -= weight * ux
            out[2] -= weight * uy
            out[3] -= weight * ut
            out[4] += weight * (normal[2] - ux * ux)
            out[5] += weight * (normal[3] - ux * uy)
            out[6] += weight * (normal[4] - uy * uy)
            out[7] += weight * (ax - ut * ux)
            out[8] += weight * (ay - ut * uy)
            out[9] += weight * (rx * ay - ry * ax - rx * ux - ry * uy - ut * ut)
    return out


@kernel
def maximise(
    points: Array, cells: Cells, pose: Array, settings: NdtSettings
) -> tuple[Array, Array, int, bool]:
    """Climb the score from ``pose`` (x, y, theta): the pose reached, its ``score_terms``, the
    iterations, and whether they converged (section V)."""
    lever = 0.0
    for point in range(len(points)):
        lever += points[point, 0] ** 2 + points[point, 1] ** 2
    lever = max(math.sqrt(lever / len(points)), 1e-6)
    terms = score_terms(points, cells, pose)
    for iteration in range(settings.max_iterations):
        if terms[0] <= 0.0:
            return pose, terms, iteration, False
        step = newton_step(terms, lever)
        length = math.sqrt(step[0] ** 2 + step[1] ** 2 + (lever * step[2]) ** 2)
        step *= min(1.0, 0.5 * cells.size / max(length, 1e-12))
        promised = ARMIJO * (terms[1] * step[0] + terms[2] * step[1] + terms[3] * step[2])
        for _ in range(HALVINGS):
            ahead = score_terms(points, cells, pose + step)
            if ahead[0] > terms[0] + promised:
                break
            step *= 0.5
            promised *= 0.5
        else:
            return pose, terms, iteration + 1, True
        pose, terms = pose + step, ahead
        small = math.hypot(step[0], step[1]) < settings.translation_epsilon
        if small and abs(step[2]) < settings.rotation_epsilon:
            return pose, terms, iteration + 1, True
    return pose, terms, settings.max_iterations, False


@kernel
def newton_step(terms: Array, lever: float) -> Array:
    """The step (x, y, theta) that raises the score: (H + shift I) step = gradient, in units in
    which theta counts as theta * ``lever`` m."""
    gradient = np.array([terms[1], terms[2], terms[3] / lever])
    H = np.empty((3, 3))
    H[0, 0], H[1, 1], H[2, 2] = terms[4], terms[6], terms[9] / lever**2
    H[0, 1] = H[1, 0] = terms[5]
    H[0, 2] = H[2, 0] = terms[7] / lever
    H[1, 2] = H[2, 1] = terms[8] / lever
    values, vectors = np.linalg.eigh(H)
    least = FLAT * max(abs(values[0]), abs(values[2]), 1e-300)
    if values[0] < least:
        # twice a negative eigenvalue, so that it becomes as large a positive one
        values = values + max(least - values[0], -2.0 * values[0])
    along = vectors.T @ gradient / values
    step = vectors @ along
    step[2] /= lever
    return step
