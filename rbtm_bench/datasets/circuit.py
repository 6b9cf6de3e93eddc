"""Closed ways on the ground, and what a simulated place in space is made of. All in metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from rbtm_bench.core.geometry import se2
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.environments import arc
from rbtm_bench.datasets.raycast import Mesh, merge

QUARTER = 0.5 * np.pi


@dataclass(frozen=True)
class Circuit:
    """A closed way of pieces (length m, curvature 1/m > 0 to the left) that starts at ``start``
    (x, y) along +x: however many scans are asked for, it goes round and never leaves the place."""

    pieces: tuple[tuple[float, float], ...]
    start: tuple[float, float] = (0.0, 0.0)

    @property
    def length(self) -> float:
        """Once round, m."""
        return sum(length for length, _ in self.pieces)

    @cached_property
    def starts(self) -> Array:
        """The pose (P, 4, 4) where every piece begins."""
        poses = [se2(*self.start, 0.0)]
        for length, curvature in self.pieces[:-1]:
            poses.append(poses[-1] @ arc(length, curvature))
        return np.stack(poses)

    def poses(self, distances: ArrayLike) -> Array:
        """Poses (S, 4, 4) on the ground after ``distances`` (S,) m."""
        lengths, curvatures = np.array(self.pieces).T
        ends = np.cumsum(lengths)
        along = np.asarray(distances, dtype=float) % ends[-1]
        piece = np.minimum(np.searchsorted(ends, along, side="right"), len(ends) - 1)
        s = along - (ends - lengths)[piece]
        turn = s * curvatures[piece]
        local = np.tile(np.eye(4), (len(s), 1, 1))
        c, sn = np.cos(turn), np.sin(turn)
        local[:, 0, 0], local[:, 0, 1], local[:, 1, 0], local[:, 1, 1] = c, -sn, sn, c
        # sin(t) / k and (1 - cos(t)) / k, written so that a straight (k = 0) needs no case
        half = np.sinc(0.5 * turn / np.pi)
        local[:, 0, 3] = s * np.sinc(turn / np.pi)
        local[:, 1, 3] = s * 0.5 * turn * half**2
        poses: Array = self.starts[piece] @ local
        return poses


def block(long: float, short: float, radius: float) -> Circuit:
    """Round a block of houses: four straights (m) and four left turns of ``radius`` (m)."""
    corner = (QUARTER * radius, 1.0 / radius)
    return Circuit(((long, 0.0), corner, (short, 0.0), corner) * 2)


@dataclass(frozen=True, eq=False)
class Place:
    """What there is, the way through it, the ``height`` of the sensor above the ground (m) and
    the way between two scans (m) unless the user says otherwise."""

    mesh: Mesh
    way: Circuit
    height: float
    step: float


def placed(meshes: Sequence[Mesh], T: Array) -> Mesh:
    """The meshes as one, moved by ``T`` (4, 4)."""
    one = merge(meshes)
    return Mesh(one.vertices @ T[:3, :3].T + T[:3, 3], one.triangles)


def slab(low: tuple[float, float], high: tuple[float, float], z: float) -> Mesh:
    """A level rectangle between corners (x, y), at height ``z``."""
    (x0, y0), (x1, y1) = low, high
    corners = np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))
