"""The simulated drive of the paper's Fig. 3, and three more places to compare it with."""

from __future__ import annotations

import hashlib
import json
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.geometry import inverse, se2, yaw
from rbtm_bench.core.kinds import Seed
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import Dataset, beam_points
from rbtm_bench.datasets.environments import ENVIRONMENTS, Environment
from rbtm_bench.datasets.raycast import scan_walls

VERSION = "corridor-1"
"""Part of the fingerprint: change it whenever the same settings give other scans."""

STEP_SECONDS = 0.1

RANGE_STREAM, ODOMETRY_STREAM = 0, 1


class Corridor(Dataset):
    """A robot with a planar laser drives through a simulated place, and everything is known.

    ``environment``: paper (a 2 m wide corridor with recesses, after Fig. 3), bare (two endless
    walls), cluttered (a room with boxes), l_turn (a corridor with a 90 degree turn).
    ``scans`` are spread evenly over ``path_length`` m of the place's path, both ends included;
    None takes the place's own length (1.8, 20, 6 and 7.57 m). Beams run from
    -``field_of_view_deg``/2 to +``field_of_view_deg``/2; nothing beyond ``max_range`` m returns.
    Gaussian noise: ``range_noise`` (m) on every range; on every odometry step
    ``odometry_noise_translation`` (share of the step's length, along and across) and
    ``odometry_noise_rotation_deg`` (deg). Ranges and odometry have random streams of their own
    from ``seed``, so changing the one leaves the other as it is.

    The ground truth starts where the path does; the odometry's frame is the first pose.
    Stamps are 0.1 s apart. Raises ``ConfigError`` if ``path_length`` leaves the place's path.
    """

    planar = True
    has_beams = True
    has_odometry = True
    has_ground_truth = True
    truth_is_exact = True

    def __init__(
        self,
        *,
        environment: Literal["paper", "bare", "cluttered", "l_turn"] = "paper",
        scans: Annotated[int, Ge(2)] = 181,
        path_length: Annotated[float, Gt(0)] | None = None,
        beams: Annotated[int, Ge(2)] = 681,
        field_of_view_deg: Annotated[float, Gt(0), Le(360)] = 240.0,
        max_range: Annotated[float, Gt(0)] = 4.0,
        range_noise: Annotated[float, Ge(0)] = 0.010,
        seed: Seed = 0,
        odometry_noise_translation: Annotated[float, Ge(0)] = 0.05,
        odometry_noise_rotation_deg: Annotated[float, Ge(0)] = 0.1,
    ) -> None:
        place = _place(environment)
        length = _path_length(environment, place, path_length)
        half = 0.5 * np.deg2rad(field_of_view_deg)
        self.angles = np.linspace(-half, half, beams)
        self.ground_truth = place.poses(np.linspace(0.0, length, scans))
        exact = scan_walls(place.walls, self.ground_truth, self.angles, max_range)
        noise = np.random.default_rng([seed, RANGE_STREAM]).standard_normal(exact.shape)
        self.ranges = exact + range_noise * noise
        # A range is a length: noise larger than the distance itself loses the return.
        self.ranges[self.ranges <= 0.0] = np.nan
        self.odometry = noisy_odometry(
            self.ground_truth,
            odometry_noise_translation,
            np.deg2rad(odometry_noise_rotation_deg),
            np.random.default_rng([seed, ODOMETRY_STREAM]),
        )
        numbers = [length, field_of_view_deg, max_range, range_noise]
        numbers += [odometry_noise_translation, odometry_noise_rotation_deg]
        settings = [environment, scans, beams, seed, *map(float, numbers)]
        determined_by = [VERSION, settings, place.walls, place.path]
        self._fingerprint = hashlib.sha256(json.dumps(determined_by).encode()).hexdigest()

    def __len__(self) -> int:
        return len(self.ranges)

    def __getitem__(self, index: int) -> Scan:
        if not 0 <= index < len(self):
            raise IndexError(f"scan {index} of {len(self)}")
        ranges = self.ranges[index]
        return Scan(
            index=index,
            stamp=index * STEP_SECONDS,
            points=beam_points(ranges, self.angles),
            planar=True,
            ranges=ranges,
            angles=self.angles,
            odometry=self.odometry[index],
            ground_truth=self.ground_truth[index],
        )

    def fingerprint(self) -> str:
        """sha256 of the settings, the walls, the path and the version of the simulation."""
        return self._fingerprint


def noisy_odometry(
    poses: Array, translation: float, rotation: float, rng: np.random.Generator
) -> Array:
    """Odometry (S, 4, 4) in the frame of the first pose, summed up from noisy planar steps.

    Standard deviations of a step: ``translation`` as a share of its length, in both directions;
    ``rotation`` in rad.
    """
    steps = inverse(poses[:-1]) @ poses[1:]
    shift = steps[:, :2, 3]
    length = np.linalg.norm(shift, axis=1, keepdims=True)
    shift = shift + translation * length * rng.standard_normal(shift.shape)
    turn = yaw(steps) + rotation * rng.standard_normal(len(steps))
    odometry = [np.eye(4)]
    for (dx, dy), dtheta in zip(shift, turn, strict=True):
        odometry.append(odometry[-1] @ se2(dx, dy, dtheta))
    return np.stack(odometry)


def _place(environment: str) -> Environment:
    if environment not in ENVIRONMENTS:
        raise ConfigError(f"environment={environment}: expected one of {', '.join(ENVIRONMENTS)}")
    return ENVIRONMENTS[environment]


def _path_length(environment: str, place: Environment, wanted: float | None) -> float:
    if wanted is None:
        return place.default_length
    if wanted > place.path_length + 1e-9:
        raise ConfigError(
            f"path_length={wanted:g} m: the path of environment={environment} "
            f"is {place.path_length:g} m long"
        )
    return wanted
