"""Which poses of a CARMEN log are odometry and which are truth, told from all that it says.

A raw log repeats the odometry of its ODOM lines in the lines of its scans, perhaps interpolated
to their times, perhaps moved to the laser. A corrected log has a path there that leaves the ODOM
lines further and further, or one that the ODOM lines jump to after every scan.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.base import Reading
from rbtm_bench.datasets.carmen_log import CarmenLog
from rbtm_bench.datasets.planar import between, compose, planar_poses

SAME = 1e-4
"""m and rad: poses this close are copies of each other."""
ON_PATH_M, ON_PATH_RAD, ON_PATH_SHARE = 0.002, np.deg2rad(0.1), 0.1
"""A pose is on the path of the ODOM lines if it is so close to a step between two of them, or
within this share of its length: interpolated poses cut corners."""
LINES_AROUND = 3
"""Steps before and after a scan's line that its pose may lie on: messages arrive late."""
MOUNT_M, MOUNT_RAD = 0.01, np.deg2rad(0.5)
"""How much a laser's place on the robot may seem to change: poses are written with few digits."""
MOST, HARDLY = 0.9, 0.5
"""Shares of scans from which on something holds, and below which it does not."""
KEYFRAME_M, KEYFRAME_RAD = 0.3, np.deg2rad(15)
"""Steps between the scans of a log that was thinned by a SLAM program are this long, or more."""
BESIDE = "on the path of the ODOM lines,"
UNTOLD = "no ODOM line tells whether the poses are odometry or corrected (dataset.corrected=)"
NO_ODOM = "no ODOM line to compare with"
SLAM_WORD = "NEFF"
"""What gmapping writes into the logs that it has corrected."""


@dataclass(frozen=True, eq=False)
class Roles:
    """``odometry`` and ``truth`` (S, 3) of the laser, each None if there is none."""

    corrected: bool
    odometry: Array | None
    truth: Array | None
    readings: tuple[Reading, ...]
    suspicions: tuple[str, ...] = ()


def find_roles(path: str, log: CarmenLog, corrected: Literal["auto"] | bool) -> Roles:
    """The roles of a log's poses. Raises ``DataError`` with both readings where it is unsure."""
    mount = _mount(log)
    if log.laser_poses is None or log.robot_poses is None:
        return _without_poses(path, log, mount)
    apart = between(log.robot_poses, log.laser_poses)
    one_path = bool(_near(apart - np.median(apart, axis=0), MOUNT_M, MOUNT_RAD).mean() > MOST)
    if corrected == "auto" and not one_path and _swapped(log):
        why = "the first triple is on the path of the ODOM lines, the second leaves it"
        truth = Reading("truth", f"poses of {log.message}, the second triple", why, "corrected")
        readings = (_odometry("the first triple", why), truth)
        return Roles(True, log.laser_poses, log.robot_poses, readings)
    if corrected == "auto":
        corrected, why = _decided(path, log, one_path)
    else:
        why = "as asked for"
    kind = f"poses of {log.message}"
    if not corrected:
        odometry, note = log.laser_poses, "the laser's"
        at_laser = BESIDE in why
        if np.any(mount) and not at_laser and _near(apart, SAME, SAME).mean() > MOST:
            odometry, note = compose(odometry, mount), f"moved to the laser by {_place(mount)}"
        taken = f"{kind}, {note}"
        readings = (_odometry(taken, why), Reading("truth", "none", "", "corrected"))
        doubts = _stillness(odometry)
        if why == NO_ODOM:
            doubts += (UNTOLD,)
        return Roles(False, odometry, None, readings, doubts)
    truth = Reading("truth", f"{kind}, the first triple", why, "corrected")
    raw, source = _beside_truth(log, one_path)
    taken, why = ("none", source) if raw is None else (source, "")
    readings = (Reading("odometry", taken, why, ""), truth)
    return Roles(True, raw, log.laser_poses, readings, _stillness(log.laser_poses))


def _odometry(taken: str, why: str) -> Reading:
    return Reading("odometry", taken, why, "corrected")


def _without_poses(path: str, log: CarmenLog, mount: Array) -> Roles:
    """RAWLASER lines have no pose: the ODOM lines around them have, by time."""
    if len(log.odom) == 0:
        why = f"{log.message} lines have no pose and there is no ODOM line"
        return Roles(False, None, None, (_odometry("none", why), Reading("truth", "none", why, "")))
    order = np.argsort(log.odom_stamps, kind="stable")
    times, odom = log.odom_stamps[order], log.odom[order]
    inside = int(np.count_nonzero((log.stamps >= times[0]) & (log.stamps <= times[-1])))
    if inside == 0:
        raise DataError(
            f"{path}: no {log.message} line between the first and the last ODOM line in time "
            f"({times[0]:.3f} to {times[-1]:.3f} s)"
        )
    theta = np.unwrap(odom[:, 2])
    columns = [np.interp(log.stamps, times, values) for values in (odom[:, 0], odom[:, 1], theta)]
    odometry = compose(np.column_stack(columns), mount)
    why = f"{log.message} lines have no pose; {inside} of {len(log.stamps)} lie between ODOM lines"
    taken = f"ODOM lines, interpolated to the scans' times, at {_place(mount)}"
    readings = (_odometry(taken, why), Reading("truth", "none", "no other pose", ""))
    return Roles(False, odometry, None, readings, _stillness(odometry))


def _swapped(log: CarmenLog) -> bool:
    """Whether the first triple follows the ODOM lines, and the second does not."""
    if len(log.odom) == 0 or log.laser_poses is None or log.robot_poses is None:
        return False
    first, second = (_on_path(log, p).mean() for p in (log.laser_poses, log.robot_poses))
    return bool(first >= MOST and second <= HARDLY)


def _decided(path: str, log: CarmenLog, one_path: bool) -> tuple[bool, str]:
    """Whether the log is corrected, and what says so."""
    by_slam = SLAM_WORD in log.words
    if not one_path:
        return True, "its two triples drift apart"
    if len(log.odom) == 0:
        if by_slam:
            return True, f"a SLAM program's {SLAM_WORD} lines"
        return False, NO_ODOM
    before, after = _around(log)
    robot = log.robot_poses
    assert robot is not None
    if _near(between(before, robot), SAME, SAME).mean() > MOST:
        return False, "copies of the ODOM lines before"
    if by_slam:
        return True, f"a SLAM program's {SLAM_WORD} lines"
    if _near(between(after, robot), SAME, SAME).mean() > HARDLY:
        return _jumps(path, log)
    on_path = float(_on_path(log, robot).mean())
    if on_path >= MOST:
        return False, f"on the path of the ODOM lines ({on_path:.0%})"
    ahead = np.median(between(before, robot), axis=0)
    beside = float(_on_path(log, compose(robot, between(ahead, np.zeros(3)))).mean())
    if beside >= MOST:
        place = f"({ahead[0]:.2f}, {ahead[1]:.2f}) m"
        return False, f"{BESIDE} at {place} from the robot ({beside:.0%})"
    if on_path <= HARDLY:
        return True, f"off the path of the ODOM lines ({1 - on_path:.0%})"
    raise _unsure(path, f"{on_path:.0%} of the scans' poses lie on the path of the ODOM lines")


def _unsure(path: str, evidence: str) -> DataError:
    return DataError(
        f"{path}: {evidence}: a raw log (dataset.corrected=false: they are the odometry) or a "
        "corrected one (dataset.corrected=true: they are the truth)?"
    )


def _jumps(path: str, log: CarmenLog) -> tuple[bool, str]:
    """ODOM lines that repeat the pose of the scan before: do they jump to it, or step as ever?"""
    robot = log.robot_poses
    assert robot is not None
    at = log.odom_before[(log.odom_before > 1) & (log.odom_before < len(log.odom) - 1)]
    step = between(log.odom[:-1], log.odom[1:])
    change = np.abs(between(step[:-1], step[1:]))  # how much a step differs from the one before
    ordinary = np.ones(len(change), dtype=bool)
    ordinary[np.concatenate([at - 1, at - 2])] = False
    if np.count_nonzero(ordinary) >= HARDLY * len(robot):
        jump = np.median(change[at - 2], axis=0)
        usual = np.median(change[ordinary], axis=0) + 0.1 * np.median(np.abs(step), axis=0) + SAME
        if (jump > 3 * usual).any():
            return True, "ODOM lines jump to the pose of the scan before them"
        return False, "ODOM lines repeat the pose of the scan before them, a step like others"
    steps = between(robot[:-1], robot[1:])
    shift, turn = np.median(np.hypot(steps[:, 0], steps[:, 1])), np.median(np.abs(steps[:, 2]))
    if shift > KEYFRAME_M or turn > KEYFRAME_RAD:
        return True, f"thinned to steps of {shift:.2f} m, and ODOM lines repeat nothing but them"
    raise _unsure(path, "the ODOM lines repeat nothing but the poses of the scans before them")


def _around(log: CarmenLog) -> tuple[Array, Array]:
    """The poses (S, 3) of the ODOM lines before and after every scan; the nearest at the ends."""
    after = log.odom_before[log.good]
    last = len(log.odom) - 1
    return log.odom[(after - 1).clip(0, last)], log.odom[after.clip(0, last)]


def _on_path(log: CarmenLog, robot: Array) -> NDArray[np.bool_]:
    """(S,) which of the scans' poses ``robot`` (S, 3) lie on a step between ODOM lines around the
    scan, in place and heading."""
    after, last = log.odom_before[log.good], len(log.odom) - 1
    found = np.zeros(len(robot), dtype=bool)
    for offset in range(-LINES_AROUND, LINES_AROUND + 1):
        a = log.odom[(after - 1 + offset).clip(0, last)]
        b = log.odom[(after + offset).clip(0, last)]
        step, off = between(a, b), between(a, robot)
        length2 = step[:, 0] ** 2 + step[:, 1] ** 2
        along = (off[:, :2] * step[:, :2]).sum(axis=1) / np.where(length2 > 0, length2, 1.0)
        along = along.clip(0.0, 1.0)
        side = np.hypot(*(off[:, :2] - along[:, None] * step[:, :2]).T)
        turn = np.maximum(
            np.minimum(0.0, step[:, 2]) - off[:, 2], off[:, 2] - np.maximum(0.0, step[:, 2])
        )
        near = side < np.maximum(ON_PATH_M, ON_PATH_SHARE * np.sqrt(length2))
        found |= near & (turn < np.maximum(ON_PATH_RAD, ON_PATH_SHARE * np.abs(step[:, 2])))
    return found


def _near(offsets: Array, shift: float, turn: float) -> NDArray[np.bool_]:
    return np.asarray(
        (np.hypot(offsets[:, 0], offsets[:, 1]) < shift) & (np.abs(offsets[:, 2]) < turn)
    )


def _beside_truth(log: CarmenLog, one_path: bool) -> tuple[Array | None, str]:
    """Odometry (S, 3) of a corrected log that holds none of its truth, and where it is from."""
    if not one_path:
        return log.robot_poses, "the second triple"
    if len(log.odom) == 0:
        return None, "no ODOM line, and both triples are the truth"
    if not _odom_follows_correction(log):
        return _around(log)[0], "ODOM lines before the scans"
    raw = _odometry_between_scans(log)
    if raw is None:
        return None, "the ODOM lines hold nothing but the truth"
    return raw, "ODOM lines without their jumps to the truth"


def _odom_follows_correction(log: CarmenLog) -> bool:
    """True if the ODOM line after a scan mostly is a copy of that scan's corrected pose."""
    after = log.odom_before[log.good]
    known = after < len(log.odom)
    if not known.any() or log.laser_poses is None:
        return False
    offset = between(log.odom[after[known]], log.laser_poses[known])
    return bool(_near(offset, SAME, SAME).mean() > HARDLY)


def _odometry_between_scans(log: CarmenLog) -> Array | None:
    """Odometry (S, 3) summed up from the ODOM lines between scans, without the jumps at scans.

    None if most scans have less than two ODOM lines between them: the one is the jump itself.
    """
    lines_between = np.diff(log.odom_before)
    if len(lines_between) and np.mean(lines_between < 2) > 0.5:
        return None
    last = (log.odom_before[1:] - 1).clip(min=0)
    first = np.minimum(log.odom_before[:-1], last)
    poses = planar_poses(log.odom)
    steps = inverse(poses[first]) @ poses[last]
    summed = [poses[max(log.odom_before[0] - 1, 0)]]
    for step in steps:
        summed.append(summed[-1] @ step)
    T = np.stack(summed)[log.good]
    return np.column_stack([T[:, 0, 3], T[:, 1, 3], np.arctan2(T[:, 1, 0], T[:, 0, 0])])


def _mount(log: CarmenLog) -> Array:
    """x, y, theta (3,) of the laser on the robot by the log's PARAM lines."""
    rear = log.message == "RLASER" or log.message.endswith("2")
    name = "robot_rearlaser" if rear else "robot_frontlaser"
    x = log.param(f"{name}_offset") or 0.0
    y = log.param(f"{name}_side_offset") or 0.0
    turn = log.param(f"{name}_angular_offset")
    return np.array([x, y, turn if turn is not None else np.pi if rear and x else 0.0])


def _place(mount: Array) -> str:
    if not np.any(mount):
        return "the robot's centre"
    return f"({mount[0]:g}, {mount[1]:g}) m, {np.degrees(mount[2]):g} deg by PARAM"


def _stillness(poses: Array) -> tuple[str, ...]:
    if len(poses) > 2 and not np.ptp(poses, axis=0).any():
        return ("the poses of all scans are the same: they say nothing of the motion",)
    return ()
