"""A spinning range sensor: beams at fixed elevations that turn about z, column by column."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from rbtm_bench.core.types import Array
from rbtm_bench.datasets.raycast import cast

ELEVATIONS_DEG = {16: (-15.0, 15.0), 32: (-25.0, 15.0), 64: (-24.8, 2.0)}
"""Lowest and highest beam of sensors with so many, as they are sold."""

BLOCK = 1 << 17
"""Rays cast at a time: 30 MB at most, whatever the sensor."""


@dataclass(frozen=True)
class Spinning:
    """``beams`` (16, 32 or 64) by ``azimuths`` columns; the first column looks backwards, the turn
    is anticlockwise and takes ``period`` s. Nothing nearer than ``min_range`` or farther than
    ``max_range`` (m) returns."""

    beams: int
    azimuths: int
    min_range: float
    max_range: float
    period: float

    @cached_property
    def directions(self) -> Array:
        """Unit vectors (azimuths, beams, 3) in the sensor frame, in the order of sensing."""
        elevation = np.deg2rad(np.linspace(*ELEVATIONS_DEG[self.beams], self.beams))[None, :]
        azimuth = np.linspace(-np.pi, np.pi, self.azimuths, endpoint=False)[:, None]
        x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
        return np.stack([x, y, np.broadcast_to(np.sin(elevation), x.shape)], axis=-1)

    @cached_property
    def times(self) -> Array:
        """When each column (azimuths,) is taken, s after the sweep begins."""
        times: Array = np.arange(float(self.azimuths)) * (self.period / self.azimuths)
        return times

    def ranges(self, scene: Any, poses: Array) -> Array:
        """Exact distances (azimuths, beams) m to the nearest surface, NaN where none returns.

        ``poses`` are T_world_sensor, (1, 4, 4) for all columns or (azimuths, 4, 4), one each.
        """
        poses = np.broadcast_to(poses, (self.azimuths, 4, 4))
        columns = max(1, BLOCK // self.beams)
        found = np.empty((self.azimuths, self.beams))
        for first in range(0, self.azimuths, columns):
            part = slice(first, first + columns)
            turned = self.directions[part] @ np.swapaxes(poses[part, :3, :3], 1, 2)
            origins = poses[part, None, :3, 3]
            found[part] = cast(scene, origins, turned, self.max_range)
        found[found < self.min_range] = np.nan
        return found
