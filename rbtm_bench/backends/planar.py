"""2D scans in 3D libraries: normals and covariances made in the plane.

Points of one plane have a normal out of that plane for a PCA on 3D neighbours: point-to-plane
then returns its guess, and generalized ICP turns into point-to-point. Every backend that needs
normals or covariances takes them from here for planar scans.
"""

from __future__ import annotations

import numpy as np

from rbtm_bench.types import Array

MIN_NEIGHBOURS = 5


def normals_2d(points: Array, radius: float, max_neighbours: int) -> Array:
    """Unit normals (N, 3) with z = 0 of planar points (N, 3).

    The direction of least spread among the neighbours within ``radius`` m, at most
    ``max_neighbours`` and at least the 5 nearest (whatever their distance).
    """
    from scipy.spatial import cKDTree

    xy = points[:, :2]
    count = min(max_neighbours, len(xy))
    distance, index = cKDTree(xy).query(xy, k=count)
    weight = (distance <= radius) | (np.arange(count) < MIN_NEIGHBOURS)
    total = weight.sum(axis=1)[:, None]
    neighbours = xy[index]
    mean = (neighbours * weight[..., None]).sum(axis=1) / total
    offset = (neighbours - mean[:, None, :]) * weight[..., None]
    cxx, cyy = (offset[..., 0] ** 2).sum(axis=1), (offset[..., 1] ** 2).sum(axis=1)
    cxy = (offset[..., 0] * offset[..., 1]).sum(axis=1)
    tangent = 0.5 * np.arctan2(2.0 * cxy, cxx - cyy)  # direction of the larger eigenvalue
    return np.column_stack([-np.sin(tangent), np.cos(tangent), np.zeros(len(xy))])


def covariances_of_discs(normals: Array, epsilon: float) -> Array:
    """Covariances (N, 3, 3) for generalized ICP: ``epsilon`` along the normal (N, 3), 1 across
    it (Segal et al. 2009); for normals in the plane that is a wall standing upright."""
    outer = normals[:, :, None] * normals[:, None, :]
    return np.eye(3) - (1.0 - epsilon) * outer
