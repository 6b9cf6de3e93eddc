"""Simulated places in space, seen by a spinning sensor: everything is known, to the millimetre."""

from __future__ import annotations

import hashlib
import json
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.kinds import Seed
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.datasets.noise_estimate import OdometryError
from rbtm_bench.datasets.perturbed import jittered
from rbtm_bench.datasets.places import PLACES
from rbtm_bench.datasets.raycast import make_scene
from rbtm_bench.datasets.spinning import Spinning

VERSION = "simulated-1"
"""Part of the fingerprint: change it whenever the same settings give other scans."""

RANGE_STREAM, ODOMETRY_STREAM, DROPOUT_STREAM = 0, 1, 2

ROLL_WAVE, PITCH_WAVE = 7.0, 11.0
"""m; the sensor sways over these distances, so that motion is in space."""


class SimulatedPlace(Dataset):
    """A spinning sensor of 16, 32 or 64 beams driven round a simulated place.

    Parameters
    ----------
    place
        street (house fronts, parked cars, poles, four turns), tunnel (an arch with recesses, alike
        elsewhere), office (a corridor with rooms and desks) or hall (boxes and pillars). All ways
        are closed, so that any number of scans may be asked for; once round are 242, 297, 78 and
        31 m.
    layout
        Draws houses, cars, recesses and furniture: another number is another street. Not a seed:
        seeds repeat a drive in the same street.
    scans, step, rate_hz
        Scans, the way between two (m; null: 0.8, 0.8, 0.15 and 0.15) and how many there are in a
        second.
    beams, azimuths
        16 (-15 to 15 deg), 32 (-25 to 15) or 64 (-24.8 to 2) beams; columns in a turn.
    min_range, max_range
        m; nothing nearer or farther returns.
    range_noise
        Standard deviation of a range, m, along its ray.
    dropout
        Share of the returns that are lost, each by itself.
    sway_deg
        Roll and pitch swing by this much on the way (deg).
    motion_distortion
        False: a sweep is taken at one instant, its stamp. True: every column from where the sensor
        is then; the points stay as measured and the truth is the pose at the stamp, when the sweep
        begins.
    seed
        Of noise, dropouts and odometry, each with a stream of its own.
    odometry_noise_translation, odometry_noise_rotation_deg
        Standard deviations on every step of the odometry, cut at three: a share of its length on
        each axis, and deg about each axis.

    Scans are made when they are asked for, the same bits every time. ``times`` of a scan are those
    of its points within the sweep, whether it is distorted or not. Raises ``ConfigError`` for an
    unknown place or sensor and for ``min_range`` beyond ``max_range``.
    """

    has_odometry = True
    has_ground_truth = True
    truth_is_exact = True

    def __init__(
        self,
        *,
        place: Literal["street", "tunnel", "office", "hall"] = "street",
        layout: Annotated[int, Ge(0)] = 0,
        scans: Annotated[int, Ge(2)] = 200,
        step: Annotated[float, Gt(0)] | None = None,
        rate_hz: Annotated[float, Gt(0)] = 10.0,
        beams: Literal[16, 32, 64] = 32,
        azimuths: Annotated[int, Ge(16), Le(36_000)] = 1024,
        min_range: Annotated[float, Ge(0)] = 0.5,
        max_range: Annotated[float, Gt(0)] = 80.0,
        range_noise: Annotated[float, Ge(0)] = 0.02,
        dropout: Annotated[float, Ge(0), Lt(1)] = 0.02,
        sway_deg: Annotated[float, Ge(0), Le(10)] = 0.5,
        motion_distortion: bool = False,
        seed: Seed = 0,
        odometry_noise_translation: Annotated[float, Ge(0)] = 0.02,
        odometry_noise_rotation_deg: Annotated[float, Ge(0)] = 0.1,
    ) -> None:
        if place not in PLACES:
            raise ConfigError(f"place={place}: expected one of {', '.join(PLACES)}")
        if beams not in (16, 32, 64):
            raise ConfigError(f"beams={beams}: expected one of 16, 32, 64")
        if min_range >= max_range:
            raise ConfigError(f"min_range={min_range:g} m: max_range is {max_range:g} m")
        self.place = PLACES[place](layout)
        self.sensor = Spinning(beams, azimuths, min_range, max_range, 1.0 / rate_hz)
        self.step = self.place.step if step is None else step
        self._sway, self._seed = float(np.deg2rad(sway_deg)), seed
        self._noise, self._dropout, self._distorted = range_noise, dropout, motion_distortion
        self.ground_truth = self.poses(self.step * np.arange(scans))
        turn = float(np.deg2rad(odometry_noise_rotation_deg))
        self.odometry = jittered(
            inverse(self.ground_truth[:1]) @ self.ground_truth,
            OdometryError(odometry_noise_translation, 0.0, turn, "set"),
            1.0,
            planar=False,
            rng=np.random.default_rng([seed, ODOMETRY_STREAM]),
        )
        mesh = self.place.mesh
        surface = hashlib.sha256(mesh.vertices.round(6).tobytes())
        surface.update(mesh.triangles.tobytes())
        numbers = [self.step, rate_hz, min_range, max_range, range_noise, dropout, sway_deg]
        numbers += [odometry_noise_translation, odometry_noise_rotation_deg]
        settings = [scans, beams, azimuths, motion_distortion, seed, *map(float, numbers)]
        by = [VERSION, place, settings, surface.hexdigest(), self.place.way.pieces]
        self._fingerprint = hashlib.sha256(json.dumps(by).encode()).hexdigest()

    def __len__(self) -> int:
        return len(self.ground_truth)

    def __getitem__(self, index: int) -> Scan:
        if not 0 <= index < len(self):
            raise IndexError(f"scan {index} of {len(self)}")
        ranges = self.ranges(index)
        hit = np.isfinite(ranges)
        return Scan(
            index=index,
            stamp=index * self.sensor.period,
            points=self.sensor.directions[hit] * ranges[hit][:, None],
            odometry=self.odometry[index],
            ground_truth=self.ground_truth[index],
            times=np.broadcast_to(self.sensor.times[:, None], hit.shape)[hit],
        )

    def fingerprint(self) -> str:
        """sha256 of the settings, the surfaces, the way and the version of the simulation."""
        return self._fingerprint

    def poses(self, distances: NDArray[np.floating[Any]]) -> Array:
        """T_world_sensor (S, 4, 4) after ``distances`` (S,) m: exact."""
        from scipy.spatial.transform import Rotation

        poses = self.place.way.poses(distances)
        poses[:, 2, 3] = self.place.height
        roll = self._sway * np.sin(2.0 * np.pi * distances / ROLL_WAVE)
        pitch = self._sway * np.sin(2.0 * np.pi * distances / PITCH_WAVE + 1.0)
        swing = Rotation.from_euler("xy", np.column_stack([roll, pitch])).as_matrix()
        poses[:, :3, :3] = poses[:, :3, :3] @ swing
        return poses

    def ranges(self, index: int) -> Array:
        """What the beams of a sweep measure (azimuths, beams), m; NaN: nothing."""
        poses = self.ground_truth[index][None]
        if self._distorted:
            share = self.sensor.times / self.sensor.period
            poses = self.poses(self.step * (index + share))
        ranges = self.sensor.ranges(self._scene, poses)
        noise = np.random.default_rng([self._seed, RANGE_STREAM, index])
        ranges += self._noise * noise.standard_normal(ranges.shape)
        # noise larger than the distance itself loses the return
        ranges[ranges <= 0.0] = np.nan
        lost = np.random.default_rng([self._seed, DROPOUT_STREAM, index]).random(ranges.shape)
        ranges[lost < self._dropout] = np.nan
        return ranges

    @cached_property
    def _scene(self) -> Any:
        return make_scene(self.place.mesh)
