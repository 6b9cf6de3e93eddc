"""Small worlds of known geometry, in numpy alone: scans with the true motion between them.

In the plane a room is ray-cast from both poses; in space its surfaces are sampled independently
for both. So no point of one scan is a point of the other, as with a real sensor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rbtm_bench.core.geometry import inverse, se2, se3, transform
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import Dataset, beam_points


def outline(*corners: tuple[float, float]) -> Array:
    """The closed polygon through corners (x, y) in m, as segments (W, 2, 2)."""
    points = np.array(corners)
    return np.stack([points, np.roll(points, -1, axis=0)], axis=1)


ROOM = np.concatenate(
    [
        # no two walls alike, so that no wrong pose fits
        outline((-3, -2), (4, -2), (4, 0.5), (4.8, 0.5), (4.8, 1.6), (4, 1.6), (4, 3), (-3, 2.4)),
        outline((-1.6, 0.9), (-0.9, 0.7), (-0.7, 1.3), (-1.4, 1.5)),
        outline((1.9, -1.3), (2.6, -1.3), (2.6, -0.8), (1.9, -0.8)),
    ]
)
"""Walls (W, 2, 2) m of a room with a recess, a slanted wall and two boxes."""

HEIGHTS = (-0.4, -0.2, 0.0, 0.2, 0.4)
"""m, of the rings of ``TinyClouds``."""

ANGLES = np.deg2rad(np.linspace(-179.5, 179.5, 360))

SURFACES = np.array(
    [
        # corner, first edge, second edge (m): floor, three walls, the faces of two boxes
        [[-4, -3, -1], [8, 0, 0], [0, 6, 0]],
        [[-4, -3, -1], [8, 0, 0], [0, 0, 2.5]],
        [[4, -3, -1], [0, 6, 0], [0, 0, 2.5]],
        [[-4, 3, -1], [5, 0, 0], [0, 0, 2]],
        [[-2, 1, -1], [1, 0.3, 0], [0, 0, 1.2]],
        [[-2, 1, -1], [-0.3, 1, 0], [0, 0, 1.2]],
        [[-2, 1, 0.2], [1, 0.3, 0], [-0.3, 1, 0]],
        [[1.5, -2, -1], [0, 1.4, 0], [0, 0, 0.8]],
        [[1.5, -2, -0.2], [1.2, 0, 0], [0, 1.4, 0]],
    ],
    dtype=float,
)
"""Parallelograms (F, 3, 3) in space."""


def cast(walls: Array, T_world_sensor: Array, angles: Array) -> Array:
    """Ranges (B,) m from a planar pose (4, 4) to the nearest of walls (W, 2, 2), NaN for none."""
    directions = np.column_stack([np.cos(angles), np.sin(angles)]) @ T_world_sensor[:2, :2].T
    d = directions[:, None]
    edge = (walls[:, 1] - walls[:, 0])[None]
    gap = walls[None, :, 0] - T_world_sensor[:2, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        along_ray = _cross(gap, edge) / _cross(d, edge)
        along_wall = _cross(gap, d) / _cross(d, edge)
    hit = (along_ray > 0) & (along_wall >= 0) & (along_wall <= 1)
    ranges = np.where(hit, along_ray, np.inf).min(axis=1)
    return np.where(np.isfinite(ranges), ranges, np.nan)


def _cross(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def planar_scan(T_world_sensor: Array, index: int = 0, noise: float = 0.0) -> Scan:
    """A laser scan of ``ROOM`` with Gaussian ``noise`` (m) drawn by a generator seeded with
    ``index``."""
    ranges = cast(ROOM, T_world_sensor, ANGLES)
    ranges = ranges + noise * np.random.default_rng(index).standard_normal(len(ranges))
    points = beam_points(ranges, ANGLES)
    return Scan(index, 0.1 * index, points, True, ranges, ANGLES.copy())


def cloud(T_world_sensor: Array, index: int = 0, noise: float = 0.0, count: int = 3000) -> Scan:
    """A cloud of ``count`` points of ``SURFACES``, drawn by a generator seeded with ``index``."""
    random = np.random.default_rng(index)
    corner, first, second = SURFACES[:, 0], SURFACES[:, 1], SURFACES[:, 2]
    area = np.linalg.norm(np.cross(first, second), axis=1)
    face = random.choice(len(SURFACES), size=count, p=area / area.sum())
    u, v = random.random((2, count, 1))
    points = corner[face] + u * first[face] + v * second[face]
    points += noise * random.standard_normal(points.shape)
    return Scan(index, 0.1 * index, transform(inverse(T_world_sensor), points))


def rotation(axis: tuple[float, float, float], degrees: float) -> Array:
    """The rotation matrix about an axis (Rodrigues)."""
    k = np.array(axis) / np.linalg.norm(axis)
    K = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    angle = np.deg2rad(degrees)
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


@dataclass(frozen=True)
class Motion:
    """The true motion between two scans, and where a registration starts."""

    T_target_source: Array
    guess: Array


@dataclass(frozen=True, repr=False)
class World:
    """Where scans are taken, and what a local method must achieve there.

    ``distance`` m is the correspondence distance to use, ``tolerance_m`` and ``tolerance_deg``
    the error allowed, less than a fifth of the motions to be found.
    """

    name: str
    distance: float
    tolerance_m: float
    tolerance_deg: float
    start: Array
    motions: dict[str, Motion]
    scan: Callable[..., Scan]

    def __repr__(self) -> str:
        return f"World({self.name})"

    def pair(self, motion: Motion, noise: float = 0.0) -> tuple[Scan, Scan]:
        """Source and target scan (in this order) with that motion between them."""
        source = self.scan(self.start @ motion.T_target_source, 1, noise)
        return source, self.scan(self.start, 2, noise)


def _from_identity(T: Array) -> Motion:
    return Motion(T, np.eye(4))


def plane_motions() -> dict[str, Motion]:
    """Motions of a robot in the plane: up to 0.15 m and 8 deg away from the guess."""
    far, off = se2(0.9, 0.4, 0.6), se2(0.08, -0.08, np.deg2rad(5))
    return {
        "still": _from_identity(np.eye(4)),
        "forward": _from_identity(se2(0.15, 0, 0)),
        "left": _from_identity(se2(0, 0.15, 0)),
        "turn": _from_identity(se2(0, 0, np.deg2rad(8))),
        "curve": _from_identity(se2(-0.1, 0.1, np.deg2rad(-8))),
        "from_far_guess": Motion(far, far @ off),
    }


def space_motions() -> dict[str, Motion]:
    """Motions in space: up to 0.3 m and 5 deg away from the guess."""
    far = se3([0.9, 0.4, 0.2], rotation((0.2, 0, 1), 35))
    off = se3([0.15, -0.1, 0.1], rotation((1, 1, 1), 4))
    still = np.eye(3)
    return {
        "still": _from_identity(np.eye(4)),
        "forward": _from_identity(se3([0.3, 0, 0], still)),
        "left": _from_identity(se3([0, 0.25, 0.15], still)),
        "turn": _from_identity(se3([0, 0, 0], rotation((0.3, 0.2, 1), 5))),
        "curve": _from_identity(se3([-0.2, 0.1, 0.1], rotation((0.5, -0.5, -1), 5))),
        "from_far_guess": Motion(far, far @ off),
    }


WORLDS = {
    "2d": World("2d", 0.5, 0.03, 1.0, se2(0.3, -0.2, 0.2), plane_motions(), planar_scan),
    "3d": World("3d", 1.0, 0.05, 1.0, se2(0.1, 0.2, 0.3), space_motions(), cloud),
}


class TinyClouds(Dataset):
    """Clouds without beams: ``ROOM`` seen in five rings from places 0.1 m apart."""

    def __init__(self, scans: int = 8) -> None:
        self.scans = scans
        self.angles = np.linspace(-np.pi, np.pi, 720, endpoint=False) + 0.5 * np.pi / 720

    def __len__(self) -> int:
        return self.scans

    def __getitem__(self, index: int) -> Scan:
        if not 0 <= index < self.scans:
            raise IndexError(f"scan {index} of {self.scans}")
        ranges = cast(ROOM, se2(0.1 * index, 0.0, 0.0), self.angles)
        ring = beam_points(ranges, self.angles)
        points = np.concatenate([ring + np.array([0, 0, z]) for z in HEIGHTS])
        return Scan(index, 0.1 * index, points)

    def fingerprint(self) -> str:
        return f"tiny-clouds-{self.scans}"
