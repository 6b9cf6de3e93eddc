"""Writes CARMEN lines for tests; repr keeps every digit."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

Pose = Sequence[float]
Write = Callable[..., str]

PLAIN_RANGES = tuple(1.0 + 0.01 * i for i in range(180))


def flaser(
    pose: Pose,
    stamp: float = 0.0,
    ranges: Sequence[float] = PLAIN_RANGES,
    robot: Pose | None = None,
) -> str:
    numbers = [*ranges, *pose, *(robot or pose), stamp]
    return f"FLASER {len(ranges)} {' '.join(repr(float(v)) for v in numbers)} host 0.5"


def odom(pose: Pose, stamp: float = 0.0) -> str:
    return f"ODOM {' '.join(repr(float(v)) for v in pose)} 0 0 0 {stamp!r} host 0.5"


def compose(pose: Pose, step: Pose) -> list[float]:
    """The planar pose after driving ``step`` from ``pose``."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    x, y = pose[0] + c * step[0] - s * step[1], pose[1] + s * step[0] + c * step[1]
    return [float(x), float(y), pose[2] + step[2]]


def drive(count: int, step: Pose = (0.1, 0.0, 0.05)) -> list[list[float]]:
    """The poses of ``count`` scans, the same step between them."""
    poses = [[0.0, 0.0, 0.0]]
    while len(poses) < count:
        poses.append(compose(poses[-1], step))
    return poses
