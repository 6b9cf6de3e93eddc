"""What looks wrong with the motions in a log: other units, other directions. Only said."""

from __future__ import annotations

import numpy as np

from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.association import nearest
from rbtm_bench.datasets.base import Relations
from rbtm_bench.datasets.planar import planar_poses

FASTEST = 10.0
"""m/s; half of the steps of a robot with a planar laser are slower."""
STEP_M = 0.01
"""Steps that are shorter have no direction."""
ALONG, ACROSS = 0.9, 0.7
"""A robot on wheels drives along its heading: mean squared cosine with it if read rightly, and at
most if read wrongly."""
TELLS, BETTER = 5, 0.3
"""Relations that are needed to tell, and the share of the error that another reading must leave."""
MANY = 0.9
"""Share of the relations that belong to scans of the log they were made for."""
TRUE_M = 0.02
"""m; three of four relations have a smaller error if the path is a corrected one."""
UNITS = (("millimetres", 1e-3), ("centimetres", 1e-2))


def motion_doubts(poses: Array, stamps: Array | None) -> tuple[str, ...]:
    """Doubts about a path of planar poses (S, 3) m, rad at stamps (S,) s, if they are known."""
    step = np.diff(poses[:, :2], axis=0)
    length = np.hypot(*step.T)
    moving = length > STEP_M
    doubts = []
    if stamps is not None and moving.any():
        time = np.diff(stamps)[moving]
        speeds = length[moving][time > 0] / time[time > 0]
        if len(speeds) and np.median(speeds) > FASTEST:
            doubts.append(
                f"half of the steps are faster than {np.median(speeds):.3g} m/s: poses in "
                "millimetres or centimetres?"
            )
    if np.count_nonzero(moving) >= TELLS:
        course = np.arctan2(step[moving, 1], step[moving, 0])
        heading = poses[:-1, 2][moving]
        in_rad, in_deg = (
            float(np.mean(np.cos(course - h) ** 2)) for h in (heading, np.deg2rad(heading))
        )
        if in_rad < ACROSS and in_deg > ALONG and np.abs(heading).max() > np.pi:
            doubts.append("the robot drives along its headings if they are degrees, not radians")
    return tuple(doubts)


def drifts(relations: Relations, stamps: Array, poses: Array | None, tolerance_s: float) -> bool:
    """Whether poses (S, 3) of scans at ``stamps`` (S,) s are so far from relations that they are
    odometry and no corrected path."""
    start, end = (nearest(stamps, t, tolerance_s) for t in (relations.start, relations.end))
    known = (start >= 0) & (end >= 0)
    if poses is None:
        return False
    T = planar_poses(poses)
    apart = (inverse(T[start[known]]) @ T[end[known]] - relations.T_start_end[known])[:, :3, 3]
    return bool(np.percentile(np.linalg.norm(apart, axis=1), 75) > TRUE_M)


def relation_doubts(
    relations: Relations, stamps: Array, odometry: Array | None, tolerance_s: float
) -> tuple[str, ...]:
    """Doubts about relations between scans at ``stamps`` (S,) s, with ``odometry`` (S, 3)."""
    start, end = (nearest(stamps, t, tolerance_s) for t in (relations.start, relations.end))
    known = (start >= 0) & (end >= 0)
    doubts = []
    if np.count_nonzero(known) < MANY * len(relations):
        doubts.append(
            f"only {np.count_nonzero(known)} of {len(relations)} relations belong to scans: "
            "another log's, or part of them in another time?"
        )
    if odometry is None or np.count_nonzero(known) < TELLS:
        return tuple(doubts)
    poses = planar_poses(odometry)
    moved = inverse(poses[start[known]]) @ poses[end[known]]
    given = relations.T_start_end[known]

    def error(T: Array) -> float:
        return float(np.median(np.linalg.norm(T[:, :3, 3] - moved[:, :3, 3], axis=1)))

    readings = {"the motions from the second time to the first": inverse(given)}
    for name, unit in UNITS:
        readings[f"in {name}"] = given.copy()
        readings[f"in {name}"][:, :3, 3] *= unit
    best = min(readings, key=lambda name: error(readings[name]))
    if error(readings[best]) < BETTER * error(given) and error(given) > STEP_M:
        doubts.append(f"the relations fit odometry better if they are {best}")
    return tuple(doubts)
