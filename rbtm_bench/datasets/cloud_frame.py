"""The unit and the frame of a folder's points, told from the points of a few clouds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.geometry import inverse, transform
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.base import Reading

FAR = 300.0
"""m; half of a scan's points are nearer to the sensor, whichever it is."""
NEAR = 0.02
"""m; and hardly so near."""
AWAY, AWAY_TIMES = 1e3, 20.0
"""Points lie in a frame of the world if they are so far (m) from its origin, and so many times
farther than from each other: the sensor is among the points that it sees."""

COARSE = 0.01
"""m; coordinates of a single precision far from the origin are farther apart."""

Way = Literal["sensor", "poses", "shift"]


@dataclass(frozen=True, eq=False)
class Frame:
    """Metres in a unit, and how points come into the sensor's frame: they are in it, by the true
    poses, or as far as may be by ``shift`` (3,) m."""

    scale: float
    way: Way
    shift: Array
    readings: tuple[Reading, ...] = ()
    suspicions: tuple[str, ...] = ()

    def metres(self, points: Array, pose: Array | None) -> Array:
        """Points (N, 3) of a file in m in the frame of the sensor, whose true pose may be known."""
        if self.scale != 1.0:
            points = points * self.scale
        if self.way == "poses" and pose is not None:
            return transform(inverse(pose), points)
        return points - self.shift if self.way == "shift" else points

    def unusual(self) -> list[object]:
        """What the scans depend on beyond the files."""
        if self.scale == 1.0 and self.way == "sensor":
            return []
        return [self.scale, self.way, *self.shift.tolist()]


def find_frame(
    path: str,
    clouds: Sequence[Array],
    poses: Sequence[Array | None],
    scale: Literal["auto"] | float,
    frame: Literal["auto", "sensor", "world"],
) -> Frame:
    """Unit and frame of a few clouds (N, 3) of a folder with their true poses, if any.

    Raises ``DataError`` with the readings that there are where the unit is unsure.
    """
    here = np.zeros(3)
    unit = 1.0 if scale == "auto" else scale
    finite = [unit * points[np.isfinite(points).all(axis=1)] for points in clouds]
    finite = [points for points in finite if len(points)]
    if not finite:
        return Frame(unit, "sensor", here)
    readings: tuple[Reading, ...] = ()
    if scale != "auto":
        readings = (Reading("unit", f"{unit:g} m", "as asked for", "scale"),)
    centres = [np.median(points, axis=0) for points in finite]
    world = all(_is_away(points, c) for points, c in zip(finite, centres, strict=True))
    if frame == "world" or (frame == "auto" and world):
        return _world(unit, finite, poses, centres[0], readings, frame)
    middle = float(np.median([np.median(np.linalg.norm(points, axis=1)) for points in finite]))
    if scale == "auto" and (middle > FAR or middle < NEAR):
        raise DataError(f"{path}: {_units(middle)}")
    return Frame(unit, "sensor", here, readings)


def _is_away(points: Array, centre: Array) -> bool:
    distance = float(np.linalg.norm(centre))
    extent = float(np.median(np.linalg.norm(points - centre, axis=1)))
    return distance > AWAY and distance > AWAY_TIMES * extent


def _world(
    unit: float,
    clouds: Sequence[Array],
    poses: Sequence[Array | None],
    centre: Array,
    readings: tuple[Reading, ...],
    asked: str,
) -> Frame:
    coarse = max(_step(points) for points in clouds)
    doubts: tuple[str, ...] = ()
    if coarse > COARSE:
        doubts = (
            f"coordinates lie {coarse:.2g} m apart at least: numbers too short for the world's",
        )
    known = [(c, T) for c, T in zip(clouds, poses, strict=False) if T is not None]
    back = [np.median(np.linalg.norm(transform(inverse(T), c), axis=1)) for c, T in known]
    where = "as asked for"
    if asked == "auto":
        distance = float(np.linalg.norm(centre))
        where = f"points {distance:.3g} m away from the origin, and near each other"
    if back and max(back) < FAR and len(back) == len(clouds):
        taken = "the world's, brought to the sensor by the true poses"
        reading = Reading("frame", taken, where, "frame")
        return Frame(unit, "poses", np.zeros(3), (*readings, reading), doubts)
    shift = np.round(centre)
    taken = f"the world's, less ({', '.join(f'{v:.0f}' for v in shift)}) m"
    doubt = (
        "the clouds are in coordinates of the world: they lie on each other already, so a "
        "registration between them is no motion of the sensor"
    )
    return Frame(
        unit, "shift", shift, (*readings, Reading("frame", taken, where, "frame")), (doubt, *doubts)
    )


def _step(points: Array) -> float:
    """The smallest distance (m) of different coordinates along the axis that is coarsest, of
    numbers that single precision holds; 0 of others, which are finer than that."""
    if not np.array_equal(points, points.astype(np.float32)):
        return 0.0
    steps = [np.diff(np.unique(points[:, axis])) for axis in range(3)]
    return max((float(step.min()) for step in steps if len(step)), default=0.0)


def _units(middle: float) -> str:
    if middle > FAR / 1e-3:
        return (
            f"half of the points are {middle:.4g} or more from the sensor: another layout or byte "
            "order (dataset.layout=), or metres all the same (dataset.scale=1)?"
        )
    asked = ", ".join(
        f"{name} (dataset.scale={scale:g}: {scale * middle:.3g} m)"
        for name, scale in (("mm", 1e-3), ("cm", 1e-2), ("km", 1e3))
        if NEAR < scale * middle < FAR
    )
    return (
        f"half of the points are {middle:.4g} or more from the sensor: no metres; {asked}, "
        "or metres all the same (dataset.scale=1)?"
    )
