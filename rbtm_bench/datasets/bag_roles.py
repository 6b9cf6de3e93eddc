"""Which topics of a bag are scans, odometry and truth, and the poses of the scans from them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.association import span
from rbtm_bench.datasets.bag_file import Topic
from rbtm_bench.datasets.bag_poses import POSE_TYPES, TF_TYPES, Track, Transforms, frame_name
from rbtm_bench.datasets.bag_scans import CLOUD, LASER
from rbtm_bench.datasets.base import Reading

TRUTH_WORDS = re.compile(r"(^|[/_])(gt|mocap|vicon|optitrack)([/_]|$)|truth")
"""What topics are called that hold the truth."""


def scan_topic(path: str, topics: Sequence[Topic], wanted: str | None) -> Topic:
    """The topic of the scans: ``wanted``, or the only one. Raises ``DataError`` with a list."""
    found = [one for one in topics if one.type in (LASER, CLOUD)]
    if wanted is not None:
        return _named(path, found, wanted, "topic")
    if len(found) == 1:
        return found[0]
    if found:
        raise DataError(f"{path}: {_listed(found)}: dataset.topic= says which")
    others = _listed(topics) or "nothing"
    raise DataError(f"{path}: no LaserScan or PointCloud2 topic; the bag has {others}")


@dataclass(frozen=True)
class Roles:
    """Topics of odometry and truth, each None if there is none, and why they are taken; a tf
    topic stands for a chain of frames."""

    odometry: Topic | None
    truth: Topic | None
    why_odometry: str
    why_truth: str


def find_roles(
    path: str, topics: Sequence[Topic], odometry: str | None, truth: str | None
) -> Roles:
    """Roles of the topics that hold poses: as named ("auto" to find out, None for none).

    Topics that are called truth (gt, mocap, vicon) are, and never odometry. Raises ``DataError``
    with a list where there are several.
    """
    poses = [one for one in topics if one.type in POSE_TYPES]
    chains = [one for one in topics if one.type in TF_TYPES]
    true, why_true = _chosen(
        path, [one for one in poses if TRUTH_WORDS.search(one.name.lower())], truth, "truth_topic",
        poses + chains, "its name says so",
    )  # fmt: skip
    candidates = [
        one
        for one in poses
        if one.type == "nav_msgs/msg/Odometry"
        and not TRUTH_WORDS.search(one.name.lower())
        and one != true
    ]
    moving = [one for one in chains if "static" not in one.name]
    measured, why = _chosen(
        path, candidates or moving[:1], odometry, "odometry_topic", poses + chains, "the only one"
    )
    return Roles(measured, true, why, why_true)


def _chosen(
    path: str,
    found: Sequence[Topic],
    wanted: str | None,
    setting: str,
    all_of_them: Sequence[Topic],
    why: str,
) -> tuple[Topic | None, str]:
    if wanted is None:
        return None, "as asked for"
    if wanted != "auto":
        return _named(path, all_of_them, wanted, setting), "as asked for"
    if len(found) > 1:
        raise DataError(f"{path}: {_listed(found)}: dataset.{setting}= says which, or null")
    return (found[0], why) if found else (None, "no such topic")


def _named(path: str, topics: Sequence[Topic], name: str, setting: str) -> Topic:
    for one in topics:
        if one.name.strip("/") == name.strip("/"):
            return one
    what = _listed(topics) or "none"
    raise DataError(f"{path}: no topic {name} for dataset.{setting}=; found {what}")


def _listed(topics: Sequence[Topic]) -> str:
    return ", ".join(map(str, topics))


@dataclass(frozen=True)
class Sensor:
    """The scans that poses are looked for: their frame, stamps (N,) s, and the tolerance (s)."""

    frame: str
    stamps: Array
    tolerance_s: float


@dataclass
class Found:
    """Poses T_world_sensor (N, 4, 4) of the scans, NaN where there is none; None without any."""

    poses: Array | None = None
    reading: Reading | None = None
    suspicions: list[str] = field(default_factory=list)


def poses_of_track(
    path: str, role: str, topic: Topic, track: Track, tree: Transforms, sensor: Sensor, why: str
) -> Found:
    """The sensor's poses from a topic of poses, moved from its child frame to the sensor by tf.

    Raises ``DataError`` with the times if none belongs to a scan.
    """
    if not track.times:
        raise DataError(f"{path}: no message of {topic.name}")
    T = track.at(path, topic.name, sensor.stamps, sensor.tolerance_s)
    count = int(np.isfinite(T[:, 0, 0]).sum())
    if count == 0:
        raise DataError(
            f"{path}: no pose of {topic.name} within {sensor.tolerance_s:g} s of a scan: poses are "
            f"from {span(np.array(track.times))}, scans from {span(sensor.stamps)}"
        )
    child, frame = frame_name(track.child), frame_name(sensor.frame)
    taken, suspicions = f"{topic.name}, {count} of {len(T)} scans by time", []
    if child and child != frame:
        mount = tree.motion(path, child, frame, sensor.stamps, sensor.tolerance_s)
        if mount is None:
            suspicions = [f"{role}: no transform from {child} to {frame}: taken as the same place"]
        else:
            T, taken = T @ mount, f"{taken}, moved from {child} to {frame}"
    elif not child:
        suspicions = [f"{role}: {topic.name} names no frame that moves: taken as the sensor's"]
    return Found(T, Reading(role, taken, why, f"{role}_topic"), suspicions)


def poses_of_tree(
    path: str, role: str, target: str, tree: Transforms, sensor: Sensor, why: str, must: bool
) -> Found:
    """The sensor's poses along tf from the frame ``target``; ``must`` there be any?"""
    T = tree.motion(path, target, sensor.frame, sensor.stamps, sensor.tolerance_s)
    count = 0 if T is None else int(np.isfinite(T[:, 0, 0]).sum())
    if T is None or count == 0:
        what = f"no chain of tf from {target} to {sensor.frame}" + (" by time" if count else "")
        if must:
            raise DataError(f"{path}: {what} (dataset.{role}_frame=)")
        return Found(None, Reading(role, "none", what, f"{role}_topic"))
    taken = f"tf from {target} to {sensor.frame}, {count} of {len(T)} scans by time"
    return Found(T, Reading(role, taken, why, f"{role}_topic"))
