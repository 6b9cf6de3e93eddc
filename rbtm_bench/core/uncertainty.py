"""How unsure a registration is, and the pose at the end of a chain of them, to first order.

Covariances (6, 6) are of a small motion d = (x, y, z, rx, ry, rz) in m and rad in the scan's own
frame: T exp(d). In the plane the rows and columns of z, rx and ry are zero. The rule of a chain is
that of Barfoot and Furgale (2014, second order in d), written for d on the right-hand side.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from rbtm_bench.core.geometry import adjoint, inverse, rotation_angle, symmetric, translation_norm
from rbtm_bench.core.types import Array, RegistrationResult

UNSEEN_STD = 1.0
"""m: how unsure a motion is along a direction that nothing measured, a turn by what it moves the
points. Information is never taken to be less, so that singular information has an inverse."""

SMALLEST_STD = 1e-3
"""m, of a matched point: identical scans would give infinite information."""

FLOOR_M, FLOOR_RAD, FLOOR_SHARE = 0.005, 0.002, 0.01
"""What a registration is unsure of, at least: m, rad, and of its motion. Information counts every
matched point as if its error were its own; calibration errors, moved furniture and the shape of
walls are common to all of them. Chosen on ACES and MIT CSAIL."""

ODOMETRY_M, ODOMETRY_RAD, ODOMETRY_SHARE = 0.01, 0.005, 0.1
"""What wheel odometry is unsure of: m, rad, and of its motion."""

InformationFrom = Literal["own", "localizability"]

PLANE, SPACE = [0, 1, 5], [0, 1, 2, 3, 4, 5]


def edge_covariance(
    result: RegistrationResult | None, planar: bool, source: InformationFrom = "own"
) -> Array:
    """The covariance (6, 6) of a registration's motion T_model_scan, or of a motion that nothing
    measured (None).

    Inverse of the information: of the method's own, if ``source`` is "own" and it gives one, else
    of the localizability's matrix x inliers / inlier RMSE^2, which is what point-to-plane matching
    would give if the points' errors were independent. Eigenvalues are floored at
    1 / ``UNSEEN_STD``^2, with turns counted in metres at the localizability's lever (1 m without).
    """
    axes = PLANE if planar else SPACE
    count = len(axes)
    held = None if result is None else result.localizability
    lever = 1.0 if held is None else held.lever
    scale = np.where(np.array(axes) < 3, 1.0, lever)
    information = np.zeros((count, count))  # of scale * d: all entries in 1 / m^2
    if result is not None and source == "own" and result.information is not None:
        information = result.information[np.ix_(axes, axes)] / np.outer(scale, scale)
    elif result is not None and held is not None:
        std = max(result.inlier_rmse, SMALLEST_STD)
        information = held.matrix * (result.inliers / std**2)
    if not np.isfinite(information).all():  # nothing that could be believed
        information = np.zeros((count, count))
    values, vectors = np.linalg.eigh(symmetric(information))
    variance = 1.0 / np.maximum(values, UNSEEN_STD**-2)
    covariance = np.zeros((6, 6))
    within = symmetric((vectors * variance) @ vectors.T)
    covariance[np.ix_(axes, axes)] = within / np.outer(scale, scale)
    return covariance


def odometry_covariance(T: Array, planar: bool) -> Array:
    """The covariance (6, 6) of a motion that odometry alone measured."""
    m = ODOMETRY_M + ODOMETRY_SHARE * float(translation_norm(T))
    rad = ODOMETRY_RAD + ODOMETRY_SHARE * float(rotation_angle(T))
    std = np.array([m, m, m, rad, rad, rad])
    if planar:
        std[[2, 3, 4]] = 0.0
    return np.diag(std**2)


def inflated(covariance: Array, T: Array, planar: bool) -> Array:
    """A covariance (6, 6) of an edge, and what no information says."""
    m = FLOOR_M + FLOOR_SHARE * float(translation_norm(T))
    rad = FLOOR_RAD + FLOOR_SHARE * float(rotation_angle(T))
    floor = np.array([m, m, m, rad, rad, rad]) ** 2
    if planar:
        floor[[2, 3, 4]] = 0.0
    return covariance + np.diag(floor)


def chained(model: Array, T_model_scan: Array, edge: Array) -> Array:
    """The covariance (6, 6) of a scan's pose out of its model scan's and the edge's between them.

    T_world_model exp(d) T_model_scan = T_world_scan exp(adjoint(T_scan_model) d): what is unsure
    about the model is moved into the scan's frame, where a turn becomes a shift as well.
    """
    A = adjoint(inverse(T_model_scan))
    return symmetric(A @ model @ A.T) + edge


def tangent_error(T: Array, truth: Array) -> Array:
    """The small motion d (6,) that takes an estimate T (4, 4) to the truth, T exp(d) = truth, in m
    and rad of T's own frame.

    Source: the logarithm of SE(3), by ``scipy.linalg.logm``.
    """
    from scipy.linalg import logm

    D = np.real(logm(inverse(T) @ truth))
    return np.array([D[0, 3], D[1, 3], D[2, 3], D[2, 1], D[0, 2], D[1, 0]])


def nees(error: Array, information: Array, seen: Array) -> float:
    """The normalised estimation error squared of an ``error`` (n,), within the subspace of the
    columns of ``seen`` (n, k): chi-square of k degrees of freedom if ``information`` (n, n) is
    honest.

    What lies across the subspace may be as unsure as it says (Schur complement), also infinitely.

    Source: Bar-Shalom, Li and Kirubarajan 2001, section 5.4.
    """
    basis = np.linalg.qr(seen, mode="complete")[0]
    k = seen.shape[1]
    M = symmetric(basis.T @ information @ basis)
    within = M[:k, :k] - M[:k, k:] @ np.linalg.pinv(M[k:, k:], hermitian=True) @ M[k:, :k]
    d = (basis.T @ error)[:k]
    return float(d @ within @ d)


def position_std(covariance: Array) -> float:
    """How far (m, root mean square) a position is off by a covariance (6, 6): the root of the
    trace of its part x, y, z, which is the same in every frame."""
    return math.sqrt(max(0.0, float(np.trace(covariance[:3, :3]))))
