"""Whether the true poses of a folder's clouds lay the clouds upon each other, or something else
does: poses of another direction, order or unit, or clouds that are in one frame already.

Points on level surfaces are left out: rings on the ground travel with the sensor, and fit best if
nothing moves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from rbtm_bench.core.geometry import inverse, se3, transform
from rbtm_bench.core.types import Array

POINTS = 4000
"""Of a cloud, evenly spread over its file."""
SOURCES = 1000
"""Of the other one are laid upon it."""
NEIGHBOURS = 12
LEVEL = 0.8
"""Of a normal along z: a floor or a ceiling."""
FAR_SHARE = 0.1
"""A distance counts as this share of the cloud's size at most."""
BETTER = 0.4
"""Share of the distance under the truth that another reading must leave to be named."""
APART = 3.0
"""It must move points by so many times what it leaves, relative to the truth."""


def truth_doubt(clouds: Sequence[Array], poses: Sequence[Array]) -> str:
    """What fits two clouds (N, 3) m better than their true poses (4, 4); "" if nothing does."""
    first, second = (cloud[np.isfinite(cloud).all(axis=1)] for cloud in clouds)
    if min(len(first), len(second)) < 10 * NEIGHBOURS:
        return ""
    cost = _cost(first, second)
    truth = inverse(poses[0]) @ poses[1]
    error, size = cost(truth), float(np.median(np.linalg.norm(second, axis=1)))
    found = {words: (cost(T), T) for words, T in _others(poses).items()}
    words = min(found, key=lambda name: found[name][0])
    left, T = found[words]
    between = truth @ inverse(T)
    moves = np.linalg.norm(between[:3, 3]) + size * np.linalg.norm(between[:3, :3] - np.eye(3))
    if left > BETTER * error or moves < APART * left:
        return ""
    return (
        f"clouds fit each other to {left:.2g} m if {words}, to {error:.2g} m by the true poses as "
        "they are read"
    )


def _others(poses: Sequence[Array]) -> dict[str, Array]:
    """Other readings of two poses, as the motion between them, by what would have to be so."""
    a, b = poses
    truth = inverse(a) @ b
    others = {
        "nothing moves (in coordinates of the world? dataset.frame=world)": np.eye(4),
        "the poses are inverse (the world's in the sensor's frame)": a @ inverse(b),
        "quaternions are qw qx qy qz": inverse(_scalar_first(a)) @ _scalar_first(b),
    }
    for words, scale in (
        ("poses in mm", 1e-3),
        ("poses in cm", 1e-2),
        ("points in dm (dataset.scale=0.1)", 10.0),
        ("points in cm (dataset.scale=0.01)", 1e2),
        ("points in feet (dataset.scale=0.3048)", 1 / 0.3048),
    ):
        others[f"the {words} are taken for m"] = se3(scale * truth[:3, 3], truth[:3, :3])
    return others


def _scalar_first(pose: Array) -> Array:
    """The pose with its quaternion's numbers, read as qx qy qz qw, read as qw qx qy qz."""
    w, x, y, z = Rotation.from_matrix(pose[:3, :3]).as_quat()
    return se3(pose[:3, 3], Rotation.from_quat([x, y, z, w]).as_matrix())


def _cost(first: Array, second: Array) -> Callable[[Array], float]:
    """Mean distance (m) of ``second``, brought by a motion, to the planes of ``first``."""
    target = first[:: max(1, len(first) // POINTS)]
    tree = cKDTree(target)
    normals = _normals(target, tree)
    upright = np.abs(normals[:, 2]) < LEVEL
    source = second[:: max(1, len(second) // SOURCES)]
    most = FAR_SHARE * float(np.median(np.linalg.norm(second, axis=1)))

    def cost(T: Array) -> float:
        brought = transform(T, source)
        distance, nearest = tree.query(brought)
        used = upright[nearest]
        if np.count_nonzero(used) < NEIGHBOURS:
            return most
        offset = np.einsum("ij,ij->i", brought - target[nearest], normals[nearest])
        along = np.where(distance < most, np.abs(offset), most)
        return float(np.mean(along[used]))

    return cost


def _normals(points: Array, tree: cKDTree) -> Array:
    near = points[tree.query(points, NEIGHBOURS)[1]]
    centred = near - near.mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))
    normals: Array = vectors[:, :, 0]
    return normals
