"""Objects that cross in front of the sensor: upright cylinders at a walk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array, Scan

PASS = 40
"""Scans after which movers are drawn anew around the sensor, so that they never stay behind."""

RADIUS = 0.15, 0.5
SPEED = 0.7, 1.6
CLOSEST = 0.4, 1.2
"""m, m/s, and how near they come, a share of the median range where they are drawn."""
TOP = 0.5
"""m above the sensor; rays that go over it miss."""


@dataclass(frozen=True)
class Mover:
    """A cylinder of ``radius`` (m) that is at ``closest`` (x, y, m) at time ``at`` (s) and goes
    with ``velocity`` (x, y, m/s), in the frame of the scan where it was drawn."""

    closest: Array
    velocity: Array
    at: float
    radius: float


class Pass:
    """Movers around the scan ``first``, a generator each, until the stamp ``until`` (s).

    They move in the world where there is truth or odometry, else relative to the sensor.
    """

    def __init__(self, first: Scan, until: float, rngs: Sequence[np.random.Generator]) -> None:
        self._truth, self._odometry = first.ground_truth, first.odometry
        ranges = np.linalg.norm(first.points, axis=1)
        scale = float(np.median(ranges)) if len(ranges) else 1.0
        self.movers = [_drawn(rng, scale, first.stamp, until) for rng in rngs]

    def ranges(self, scan: Scan, rays: Array) -> Array:
        """Distances (N,) m to the nearest mover along unit rays (N, 3) of the scan; NaN: none."""
        T = np.eye(4)
        if self._truth is not None and scan.ground_truth is not None:
            T = inverse(scan.ground_truth) @ self._truth
        elif self._odometry is not None and scan.odometry is not None:
            T = inverse(scan.odometry) @ self._odometry
        found = np.full(len(rays), np.nan)
        for mover in self.movers:
            x, y = mover.closest + (scan.stamp - mover.at) * mover.velocity
            centre = T @ np.array([x, y, 0.0, 1.0])
            found = np.fmin(found, cylinder(rays, centre[:3], mover.radius))
        return found


def _drawn(rng: np.random.Generator, scale: float, begin: float, until: float) -> Mover:
    bearing, side = rng.uniform(-np.pi, np.pi), 1.0 if rng.random() < 0.5 else -1.0
    away = scale * rng.uniform(*CLOSEST)
    along = np.array([np.cos(bearing), np.sin(bearing)])
    across = side * np.array([-along[1], along[0]])
    speed, at = rng.uniform(*SPEED), rng.uniform(begin, max(begin, until))
    return Mover(away * along, speed * across, at, rng.uniform(*RADIUS))


def cylinder(rays: Array, centre: Array, radius: float) -> Array:
    """Distances (N,) m along unit rays (N, 3) from the origin to an upright cylinder, NaN where
    it is missed; it hides nothing from a sensor within it."""
    level = (rays[:, :2] ** 2).sum(axis=1)
    towards = rays[:, :2] @ centre[:2]
    beyond = float(centre[:2] @ centre[:2]) - radius**2
    root = towards**2 - level * beyond
    hit = (root >= 0.0) & (towards > 0.0) & (level > 0.0) & (beyond > 0.0)
    found = np.full(len(rays), np.nan)
    found[hit] = (towards[hit] - np.sqrt(root[hit])) / level[hit]
    found[rays[:, 2] * found > centre[2] + TOP] = np.nan
    return found
