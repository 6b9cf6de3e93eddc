"""Simulated range sensors: rays against triangle meshes, through Open3D's RaycastingScene.

Open3D is imported where it is used: it takes 1.6 s, and this module must stay light to import.
Meshes and rays are float32 inside Open3D, so ranges of a few metres are exact to about 1 um.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rbtm_bench.core.open3d_library import open3d
from rbtm_bench.core.types import Array

WALL_BOTTOM = -1.0
WALL_TOP = 1.0
"""m; a planar scan looks along z = 0, halfway up the walls."""


class Mesh(NamedTuple):
    """``vertices`` (V, 3) m and ``triangles`` (T, 3), indices into the vertices."""

    vertices: Array
    triangles: NDArray[np.int64]


def walls_mesh(segments: ArrayLike, bottom: float = WALL_BOTTOM, top: float = WALL_TOP) -> Mesh:
    """Vertical rectangles over ground segments (W, 2, 2), from ``bottom`` to ``top`` (m)."""
    ends = np.asarray(segments, dtype=float).reshape(-1, 2, 2)
    quads = np.empty((len(ends), 4, 3))
    quads[:, :2, :2] = ends
    quads[:, 2:, :2] = ends[:, ::-1]
    quads[:, :2, 2] = bottom
    quads[:, 2:, 2] = top
    corner = 4 * np.arange(len(ends))[:, None, None]
    triangles = corner + np.array([[0, 1, 2], [0, 2, 3]])
    return Mesh(quads.reshape(-1, 3), triangles.reshape(-1, 3))


def rectangle(low: ArrayLike, high: ArrayLike) -> Array:
    """The outline (4, 2, 2) of the rectangle between corners ``low`` and ``high`` (x, y in m)."""
    (x0, y0), (x1, y1) = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def box_mesh(low: ArrayLike, high: ArrayLike) -> Mesh:
    """A closed axis-parallel box between corners ``low`` and ``high`` (x, y, z in m)."""
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    sides = walls_mesh(rectangle(low[:2], high[:2]), low[2], high[2])
    return merge([sides, _floor(low, high, low[2]), _floor(low, high, high[2])])


def _floor(low: Array, high: Array, z: float) -> Mesh:
    (x0, y0), (x1, y1) = low[:2], high[:2]
    corners = np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))


def pillar_mesh(
    center: ArrayLike, radius: float, bottom: float, top: float, sides: int = 24
) -> Mesh:
    """The side faces of an upright prism around ``center`` (x, y), ``radius`` (m) to its edges."""
    turn = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    ring = np.asarray(center, dtype=float) + radius * np.column_stack([np.cos(turn), np.sin(turn)])
    return walls_mesh(np.stack([ring, np.roll(ring, -1, axis=0)], axis=1), bottom, top)


def merge(meshes: Iterable[Mesh]) -> Mesh:
    """One mesh of several."""
    parts = list(meshes)
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    return Mesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.triangles + k for part, k in zip(parts, offsets, strict=True)]),
    )


def make_scene(mesh: Mesh) -> Any:
    """An Open3D ``RaycastingScene`` of the mesh."""
    o3d = open3d()

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor.from_numpy(np.ascontiguousarray(mesh.vertices, dtype=np.float32)),
        o3d.core.Tensor.from_numpy(np.ascontiguousarray(mesh.triangles, dtype=np.uint32)),
    )
    return scene


def cast(scene: Any, origins: ArrayLike, directions: ArrayLike, max_range: float) -> Array:
    """Distances (...,) m along rays to the first surface, NaN for none within ``max_range`` (m).

    ``origins`` and ``directions`` broadcast to (..., 3); directions need not be of unit length.
    """
    o3d = open3d()

    directions = np.asarray(directions, dtype=float)
    directions = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    origins, directions = np.broadcast_arrays(np.asarray(origins, dtype=float), directions)
    rays = np.concatenate([origins, directions], axis=-1).astype(np.float32)
    # One ray alone is no batch for Open3D, hence the reshaping.
    hits = scene.cast_rays(o3d.core.Tensor.from_numpy(rays.reshape(-1, 6)))["t_hit"].numpy()
    ranges: Array = hits.astype(np.float64).reshape(rays.shape[:-1])
    ranges[~(ranges <= max_range)] = np.nan
    return ranges


def scan_walls(segments: ArrayLike, poses: Array, angles: Array, max_range: float) -> Array:
    """Noise-free ranges (S, B) m of planar scans: walls (W, 2, 2), all scans in one cast.

    ``poses`` (S, 4, 4) are T_world_sensor in the plane, ``angles`` (B,) rad in the sensor frame.
    """
    local = np.stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))], axis=-1)
    directions = local[None] @ np.swapaxes(poses[:, :3, :3], -1, -2)
    return cast(make_scene(walls_mesh(segments)), poses[:, None, :3, 3], directions, max_range)
