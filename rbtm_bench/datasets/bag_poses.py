"""Poses in a bag: from nav_msgs/Odometry and its like, or along a chain of transforms (tf)."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array

POSE_TYPES = {
    "nav_msgs/msg/Odometry": "pose.pose",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "pose.pose",
    "geometry_msgs/msg/PoseStamped": "pose",
}
"""Messages that hold a pose, and where."""
TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
UNIT = 0.01
"""How far the norm of a quaternion may be from 1."""
FARTHEST = 1e7
"""m from the origin of any frame."""
SAME_TIME = 1e-3
"""s: a pose that is so near in time needs no other one to interpolate with."""
LONGEST_CHAIN = 50


def seconds(stamp: Any) -> float:
    """s of a builtin_interfaces/Time; ROS 1 and 2 write nanoseconds beside whole seconds."""
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def frame_name(name: str) -> str:
    """A frame without the slash in front that ROS 1 once had."""
    return name.strip().lstrip("/")


@dataclass
class Track:
    """Poses by time, as they come: ``times`` (s) and rows of x, y, z (m) and qx, qy, qz, qw."""

    times: list[float] = field(default_factory=list)
    rows: list[tuple[float, ...]] = field(default_factory=list)
    parent: str = ""
    child: str = ""

    def add(self, stamp: Any, position: Any, orientation: Any) -> None:
        """Append a pose out of a message."""
        p, q = position, orientation
        self.times.append(seconds(stamp))
        self.rows.append((p.x, p.y, p.z, q.x, q.y, q.z, q.w))

    def at(self, path: str, what: str, times: Array, tolerance_s: float) -> Array:
        """Poses (N, 4, 4) at ``times`` (N,) s, NaN where there is none.

        Interpolated between the poses before and after, both within ``tolerance_s`` (s).
        Raises ``DataError`` for numbers that are no poses.
        """
        from scipy.spatial.transform import Rotation

        known, first = np.unique(np.array(self.times), return_index=True)
        rows = np.array(self.rows, dtype=np.float64)[first]
        _check(path, what, rows)
        after = np.searchsorted(known, times).clip(max=len(known) - 1)
        before = (np.searchsorted(known, times, side="right") - 1).clip(min=0)
        gaps = known[after] - known[before]
        late, early = times - known[before], known[after] - times
        share = np.divide(late, gaps, out=np.zeros(len(times)), where=gaps > 0).clip(0, 1)
        start = Rotation.from_quat(rows[before, 3:])
        turn = (start.inv() * Rotation.from_quat(rows[after, 3:])).as_rotvec()
        T = np.tile(np.eye(4), (len(times), 1, 1))
        T[:, :3, :3] = (start * Rotation.from_rotvec(share[:, None] * turn)).as_matrix()
        step = rows[after, :3] - rows[before, :3]
        T[:, :3, 3] = rows[before, :3] + share[:, None] * step
        near = np.minimum(np.abs(late), np.abs(early)) <= SAME_TIME
        between = (late >= 0) & (early >= 0) & (late <= tolerance_s) & (early <= tolerance_s)
        T[~(near | between)] = np.nan
        return T


def _check(path: str, what: str, rows: Array) -> None:
    norms = np.linalg.norm(rows[:, 3:], axis=1)
    bad = ~(np.abs(norms - 1) <= UNIT) | ~(np.abs(rows[:, :3]) <= FARTHEST).all(axis=1)
    if bad.any():
        x, y, z, *q = rows[int(np.argmax(bad))]
        quaternion = ", ".join(f"{value:.3g}" for value in q)
        raise DataError(
            f"{path}: {np.count_nonzero(bad)} of {len(rows)} poses of {what} are none, such as "
            f"({x:.3g}, {y:.3g}, {z:.3g}) with the quaternion ({quaternion})"
        )


class Transforms:
    """The tree of frames in a bag's tf topics."""

    def __init__(self) -> None:
        self._moving: dict[tuple[str, str], Track] = defaultdict(Track)
        self._static: dict[tuple[str, str], Track] = defaultdict(Track)

    def add(self, message: Any, static: bool) -> None:
        """Take the transforms of a TFMessage in."""
        tracks = self._static if static else self._moving
        for one in message.transforms:
            key = (frame_name(one.header.frame_id), frame_name(one.child_frame_id))
            moved = one.transform
            tracks[key].add(one.header.stamp, moved.translation, moved.rotation)

    def chain(self, target: str, source: str) -> list[tuple[str, str]] | None:
        """The edges (parent, child) from ``target`` down to ``source``; None if there are none."""
        target, source = frame_name(target), frame_name(source)
        below: dict[str, list[tuple[str, str]]] = {source: []}
        front = [source]
        for _ in range(LONGEST_CHAIN):
            if target in below:
                return below[target]
            edges = [e for e in (*self._static, *self._moving) if e[1] in front]
            front = []
            for parent, child in edges:
                if parent not in below:
                    below[parent] = [(parent, child), *below[child]]
                    front.append(parent)
        return None

    def motion(
        self, path: str, target: str, source: str, times: Array, tolerance_s: float
    ) -> Array | None:
        """T_target_source (N, 4, 4) at ``times`` (s), NaN where unknown; None without a chain.

        The chain may lead down (target above source) or up.
        """
        edges = self.chain(target, source)
        if edges is None:
            upward = self.chain(source, target)
            if upward is None:
                return None
            return inverse(self._along(path, upward, times, tolerance_s))
        return self._along(path, edges, times, tolerance_s)

    def _along(
        self, path: str, edges: list[tuple[str, str]], times: Array, tolerance_s: float
    ) -> Array:
        T = np.tile(np.eye(4), (len(times), 1, 1))
        for edge in edges:
            what = f"tf {edge[0]} to {edge[1]}"
            if edge in self._static:
                last = self._static[edge]
                one = Track([0.0], [last.rows[-1]])
                T = T @ one.at(path, what, np.zeros(1), 0.0)
            else:
                T = T @ self._moving[edge].at(path, what, times, tolerance_s)
        return T
