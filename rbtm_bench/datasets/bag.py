"""Bags of ROS 1 and ROS 2: a planar laser or point clouds, odometry, perhaps the truth."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.geometry import to_plane
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets import bag_file, bag_roles
from rbtm_bench.datasets.association import time_suspicions
from rbtm_bench.datasets.bag_poses import (
    POSE_TYPES,
    TF_TYPES,
    Track,
    Transforms,
    frame_name,
    seconds,
)
from rbtm_bench.datasets.bag_scans import (
    LASER,
    cloud_points,
    laser_geometry,
    spacing_suspicion,
)
from rbtm_bench.datasets.base import Dataset, Drops, Reading, beam_points
from rbtm_bench.datasets.carmen_sensor import FARTHEST_READING, NO_RETURN_BAND, lone_value
from rbtm_bench.datasets.cloud_files import usable

VERSION = "bag-1"
"""Part of the fingerprint: change it whenever the same bag and settings give other scans."""
SAMPLE = 200
"""Scans that no returns are told from."""
UPSIDE_DOWN = -0.9
"""A laser whose z axis points down so far hangs from something."""


@dataclass
class _Seen:
    """What one pass over a bag finds: of each scan its place in the bag, stamp and geometry."""

    places: list[tuple[int, int]] = field(default_factory=list)
    stamps: list[float] = field(default_factory=list)
    beams: list[tuple[float, float, int]] = field(default_factory=list)
    limits: list[tuple[float, float]] = field(default_factory=list)
    sample: list[Array] = field(default_factory=list)
    frame: str = ""
    tree: Transforms = field(default_factory=Transforms)
    tracks: dict[str, Track] = field(default_factory=dict)


class Bag(Dataset):
    """The scans of one topic of a bag: a ROS 1 ``.bag``, a ROS 2 folder, ``.db3`` or ``.mcap``.

    **Topics.** ``topic`` is a sensor_msgs/LaserScan (planar, with beams) or PointCloud2; None takes
    the only one. ``odometry_topic`` is a nav_msgs/Odometry (or another pose), or a tf topic, of
    which the chain from ``odometry_frame`` to the sensor is taken; ``truth_topic`` and
    ``truth_frame`` likewise. "auto" takes the only nav_msgs/Odometry, else tf; the truth only from
    a topic that is called so; None takes none. Poses of a robot are moved to the sensor by tf.

    **Times** are the headers' (the recorder's where all headers say 0). Scans are in the order of
    recording. Poses are interpolated to them between two within ``tolerance_s`` (s). Scans without
    odometry are left out, which is said, and refused if they are most; a scan may lack a truth.

    **Ranges.** No return: NaN or infinite, shorter than ``min_range`` or not shorter than
    ``max_range`` (m); None takes the message's, or a shorter value at the far end that many
    readings share. ``angles`` (first, spacing) in deg replace the message's. Points of clouds
    within ``min_range``, beyond ``max_range``, not finite or implausible are left out. All are
    counted.

    ``stride`` keeps every n-th scan, then ``max_scans`` the first so many. Raises ``DataError`` for
    a bag that is damaged or has no such topics, ``ConfigError`` if rosbags is not installed.
    """

    def __init__(
        self,
        path: str,
        topic: str | None = None,
        odometry_topic: str | None = "auto",
        truth_topic: str | None = "auto",
        odometry_frame: str = "odom",
        truth_frame: str = "map",
        tolerance_s: Annotated[float, Gt(0)] = 0.25,
        max_range: Annotated[float, Gt(0)] | None = None,
        min_range: Annotated[float, Ge(0)] | None = None,
        angles: tuple[float, float] | None = None,
        stride: Annotated[int, Ge(1)] = 1,
        max_scans: Annotated[int, Ge(1)] | None = None,
    ) -> None:
        self._path, self._drops = path, Drops()
        topics = bag_file.topics(path)
        self.topic = bag_roles.scan_topic(path, topics, topic)
        self.planar = self.has_beams = self.topic.type == LASER
        roles = bag_roles.find_roles(path, topics, odometry_topic, truth_topic)
        seen = self._pass(roles, topics)
        self._times(seen)
        self._angles = angles
        self._limits(seen, min_range, max_range)
        sensor = bag_roles.Sensor(seen.frame, self.stamps, float(tolerance_s))
        ask = (odometry_frame, odometry_topic), (truth_frame, truth_topic)
        self.odometry, self.ground_truth = (
            self._poses(role, one, why, seen, sensor, *asked)
            for role, one, why, asked in (
                ("odometry", roles.odometry, roles.why_odometry, ask[0]),
                ("truth", roles.truth, roles.why_truth, ask[1]),
            )
        )
        self._hang(seen)
        self._take(seen, stride, max_scans)
        self.suspicions += tuple(time_suspicions(self.stamps))
        self._cursor = bag_file.Cursor(path, self.topic.name)
        self._settings = [VERSION, self.topic.name, self.min_range, self.max_range, angles, stride]
        self._settings += [max_scans, float(tolerance_s)]
        self._fingerprint: str | None = None

    def _pass(self, roles: bag_roles.Roles, topics: Sequence[bag_file.Topic]) -> _Seen:
        """Look at every message of the topics that count."""
        seen, every = _Seen(), max(1, self.topic.count // SAMPLE)
        wanted = {one.name for one in (roles.odometry, roles.truth) if one is not None}
        wanted |= {one.name for one in topics if one.type in TF_TYPES} | {self.topic.name}
        types = {one.name: one.type for one in topics}
        for message in bag_file.messages(self._path, wanted):
            with bag_file.told(self._path):
                kind = types[message.topic]
                if message.topic == self.topic.name:
                    self._see(seen, message, every)
                elif kind in POSE_TYPES:
                    track = seen.tracks.setdefault(message.topic, Track())
                    _add_pose(track, message.content, kind)
                else:
                    seen.tree.add(message.content, static="static" in message.topic)
        if not seen.places:
            raise DataError(f"{self._path}: no message of {self.topic.name}")
        return seen

    def _see(self, seen: _Seen, message: bag_file.Message, every: int) -> None:
        content, number = message.content, len(seen.places)
        frame = frame_name(content.header.frame_id)
        if number == 0:
            seen.frame = frame
        elif frame != seen.frame:
            raise DataError(f"{self._where(number)}: of frame {frame}, the first of {seen.frame}")
        seen.places.append((message.time, message.rank))
        seen.stamps.append(seconds(content.header.stamp))
        if self.planar:
            seen.beams.append(laser_geometry(self._where(number), content))
            seen.limits.append((float(content.range_min), float(content.range_max)))
            if number % every == 0:
                seen.sample.append(np.array(content.ranges, dtype=np.float64))

    def _where(self, scan: int) -> str:
        return f"{self._path}, {self.topic.name} {scan}"

    def _times(self, seen: _Seen) -> None:
        self.stamps: Array = np.array(seen.stamps)
        taken = "those of the headers"
        if len(self.stamps) > 1 and not self.stamps.any():
            self.stamps = 1e-9 * np.array([time for time, _ in seen.places], dtype=np.float64)
            taken = "those of the recorder: all headers say 0"
        self.readings += (
            Reading("scans", str(self.topic), "", "topic"),
            Reading("times", taken, "", ""),
        )

    def _limits(self, seen: _Seen, min_range: float | None, max_range: float | None) -> None:
        """Which ranges are no returns, and what is odd about the beams."""
        low, high, why = 0.0, np.inf, "no limit in the messages"
        if self.planar:
            limits = np.array(seen.limits)
            own = np.median(limits, axis=0)
            if np.isfinite(own).all() and 0 <= own[0] < own[1]:
                low, high, why = float(own[0]), float(own[1]), "range_max"
                if len(np.unique(limits, axis=0)) > 1:
                    self.suspicions += ("range_min or range_max change from scan to scan",)
            value, count = lone_value(np.concatenate(seen.sample))
            if value is not None and value - NO_RETURN_BAND < high:
                high = value - NO_RETURN_BAND
                why = f"{count} readings of a sample are {value:g} m, all alone"
            self._beams(seen)
        if max_range is not None:
            high, why = float(max_range), "as asked for"
        self.min_range = low if min_range is None else float(min_range)
        self.max_range = high
        taken = "none" if np.isinf(high) else f"from {high:g} m on"
        if self.min_range > 0:
            taken += f", and below {self.min_range:g} m"
        self.readings += (Reading("no return", taken, why, "max_range"),)

    def _beams(self, seen: _Seen) -> None:
        first, spacing, beams = seen.beams[0]
        counts = {count for _, _, count in seen.beams}
        if len(counts) > 1:
            self.suspicions += (f"scans have {min(counts)} to {max(counts)} beams",)
        why = "angle_min and angle_increment"
        if self._angles is not None:
            first, spacing = np.deg2rad(self._angles)
            why = "as asked for"
        else:
            self.suspicions += tuple(spacing_suspicion(first, spacing, beams))
            if len({one[:2] for one in seen.beams}) > 1:
                self.suspicions += ("the angles of the beams change from scan to scan",)
        degrees = np.rad2deg([first, first + spacing * (beams - 1), spacing])
        taken = f"{beams} from {degrees[0]:.6g} to {degrees[1]:.6g} by {degrees[2]:.6g} deg"
        self.readings += (Reading("beams", taken, why, "angles"),)

    def _poses(
        self,
        role: str,
        topic: bag_file.Topic | None,
        why: str,
        seen: _Seen,
        sensor: bag_roles.Sensor,
        frame: str,
        asked: str | None,
    ) -> Array | None:
        if topic is None:
            self.readings += (Reading(role, "none", why, f"{role}_topic"),)
            return None
        if topic.type in POSE_TYPES:
            track = seen.tracks.get(topic.name, Track())
            found = bag_roles.poses_of_track(self._path, role, topic, track, seen.tree, sensor, why)
        else:
            must = asked != "auto"
            found = bag_roles.poses_of_tree(self._path, role, frame, seen.tree, sensor, why, must)
        self.readings += () if found.reading is None else (found.reading,)
        self.suspicions += tuple(found.suspicions)
        return found.poses

    def _hang(self, seen: _Seen) -> None:
        """Bring poses of a planar laser into the plane; one that hangs is turned with its beams."""
        self._turn = 1.0
        known = self.odometry if self.odometry is not None else self.ground_truth
        if not self.planar or known is None:
            return
        up = known[:, 2, 2][np.isfinite(known[:, 2, 2])]
        if len(up) and np.median(up) < UPSIDE_DOWN:
            self._turn = -1.0
            self.suspicions += ("the laser hangs upside down: its beams are turned over",)
        flip = np.diag([1.0, self._turn, self._turn, 1.0])
        for name in ("odometry", "ground_truth"):
            poses = getattr(self, name)
            if poses is not None:
                flat = [T if np.isnan(T[0, 0]) else to_plane(T @ flip) for T in poses]
                setattr(self, name, np.array(flat))

    def _take(self, seen: _Seen, stride: int, max_scans: int | None) -> None:
        """Keep the scans that are used, with what belongs to them."""
        used = np.arange(len(seen.places))
        if self.odometry is not None:
            used = used[np.isfinite(self.odometry[:, 0, 0])]
            lost = len(seen.places) - len(used)
            if lost > len(used):
                raise DataError(
                    f"{self._path}: {lost} of {len(seen.places)} scans have no odometry in time: "
                    "dataset.tolerance_s= (s) allows for rarer poses, dataset.odometry_topic=null "
                    "does without"
                )
            if lost:
                self.suspicions += (f"{lost} scans without odometry in time are left out",)
        used = used[::stride][:max_scans]
        self._used = used
        self._places = [seen.places[i] for i in used]
        self.stamps = self.stamps[used]
        self.odometry = None if self.odometry is None else self.odometry[used]
        self.ground_truth = None if self.ground_truth is None else self.ground_truth[used]
        self.has_odometry = self.odometry is not None
        self.has_ground_truth = bool(
            self.ground_truth is not None and np.isfinite(self.ground_truth[:, 0, 0]).any()
        )

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, index: int) -> Scan:
        if not 0 <= index < len(self):
            raise IndexError(f"scan {index} of {len(self)}")
        truth = None if self.ground_truth is None else self.ground_truth[index]
        known: dict[str, Any] = {
            "odometry": None if self.odometry is None else self.odometry[index],
            "ground_truth": None if truth is None or np.isnan(truth[0, 0]) else truth,
        }
        number = int(self._used[index])
        message = self._cursor.message(number, *self._places[index])
        stamp = float(self.stamps[index])
        with bag_file.told(self._path):
            if self.planar:
                ranges, angles = self._ranges(index, message)
                points = beam_points(ranges, angles)
                return Scan(index, stamp, points, True, ranges, angles, **known)
            where = self._where(number)
            points = cloud_points(where, message)
            kept, causes = usable(Path(where), points, self.min_range, self.max_range)
            self._drops.note(index, **causes)
            return Scan(index, stamp, kept, **known)

    def _ranges(self, index: int, message: Any) -> tuple[Array, Array]:
        """Ranges (B,) m, NaN for no return, and angles (B,) rad of a LaserScan."""
        readings = np.array(message.ranges, dtype=np.float64)
        finite = np.isfinite(readings)
        near = finite & ((readings < self.min_range) | (readings <= 0))
        far = finite & (readings >= self.max_range)
        absurd = finite & ~near & ~far & (readings > FARTHEST_READING)
        causes = {"not_finite": ~finite, "too_near": near, "no_return": far, "beyond_10_km": absurd}
        self._drops.note(index, **{cause: mask.sum() for cause, mask in causes.items()})
        readings[~finite | near | far | absurd] = np.nan
        first, spacing = float(message.angle_min), float(message.angle_increment)
        if self._angles is not None:
            first, spacing = (float(np.deg2rad(angle)) for angle in self._angles)
        steps = np.arange(len(readings), dtype=np.float64)
        return readings, self._turn * (first + spacing * steps)

    def dropped(self) -> dict[str, int]:
        return self._drops.total()

    def fingerprint(self) -> str:
        """sha256 of the bag's files, the poses taken from it and the settings."""
        if self._fingerprint is None:
            digest = hashlib.sha256(repr(self._settings).encode())
            digest.update(bag_file.content_digest(self._path).encode())
            for poses in (self.odometry, self.ground_truth):
                digest.update(b"none" if poses is None else poses.tobytes())
            self._fingerprint = digest.hexdigest()
        return self._fingerprint


def _add_pose(track: Track, message: Any, kind: str) -> None:
    pose: Any = message
    for name in POSE_TYPES[kind].split("."):
        pose = getattr(pose, name)
    track.child = str(getattr(message, "child_frame_id", ""))
    track.add(message.header.stamp, pose.position, pose.orientation)
