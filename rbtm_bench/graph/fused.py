"""One motion out of several that were measured of it: the smallest pose graph, solved in place."""

from __future__ import annotations

import numpy as np

from rbtm_bench.core.trajectory import orthonormalised
from rbtm_bench.core.types import Array
from rbtm_bench.core.uncertainty import PLANE, SPACE
from rbtm_bench.graph import motions
from rbtm_bench.graph.robust import dcs

STEPS, ENOUGH = 20, 1e-10
"""Gauss-Newton steps at most, and the change (m, rad) below which it ends."""


def fused(measured: Array, covariances: Array, planar: bool, phi: float) -> tuple[Array, Array]:
    """The motion (4, 4) that agrees best with ``measured`` ones (K, 4, 4), and its covariance
    (6, 6), given theirs (K, 6, 6), independent, of small motions in the scan's own frame.

    Gauss-Newton on the sum of e^T C^-1 e, e as in ``motions.residuals``, from the measured motion
    that agrees best with the others; each counts less the more it disagrees (``robust.dcs`` with
    ``phi``), so that one wrong of several does not decide.
    """
    axes = PLANE if planar else SPACE
    within = np.ix_(range(len(measured)), axes, axes)
    weights: Array = np.linalg.inv(covariances[within]).astype(np.float64)
    here = np.broadcast_to(np.eye(4), measured.shape)
    costs = [_scaled(measured, T, weights, axes, phi)[2].sum() for T in measured]
    T = measured[int(np.argmin(costs))]
    H = weights.sum(axis=0)
    for _ in range(STEPS):
        e, scale, _ = _scaled(measured, T, weights, axes, phi)
        whole = motions.residuals(here, np.broadcast_to(T, measured.shape), measured)
        J = motions.jacobians(measured, whole)[1][within]
        weighted = np.swapaxes(J, 1, 2) @ (weights * (scale**2)[:, None, None])
        H = (weighted @ J).sum(axis=0)
        step = np.zeros((1, 6))
        step[0, axes] = np.linalg.solve(H, -(weighted @ e[:, :, None]).sum(axis=0)[:, 0])
        T = orthonormalised(motions.moved(T[None], step))[0]
        if np.abs(step).max() < ENOUGH:
            break
    covariance = np.zeros((6, 6))
    covariance[np.ix_(axes, axes)] = np.linalg.inv(H)
    return T, covariance


def _scaled(
    measured: Array, T: Array, weights: Array, axes: list[int], phi: float
) -> tuple[Array, Array, Array]:
    """What a motion is off from each measured one (K, D), the scales and the costs (K,)."""
    here = np.broadcast_to(np.eye(4), measured.shape)
    e = motions.residuals(here, np.broadcast_to(T, measured.shape), measured)[:, axes]
    scale, cost = dcs(((weights @ e[:, :, None])[:, :, 0] * e).sum(axis=1), phi)
    return e, scale, cost
