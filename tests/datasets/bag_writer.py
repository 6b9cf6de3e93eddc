"""Bags of ROS 1 and ROS 2, written by rosbags: messages with their topic and time in ns."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="bags need the package rosbags")

from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORES = {"bag": get_typestore(Stores.ROS1_NOETIC)}
STORES["db3"] = STORES["mcap"] = get_typestore(Stores.ROS2_HUMBLE)
TF = "geometry_msgs/TransformStamped[] transforms"
STORES["bag"].register(get_types_from_msg(TF, "tf2_msgs/msg/TFMessage"))
START = 1_700_000_000 * 10**9
Entry = tuple[str, int, Any]


class Messages:
    """Makes messages of one kind of bag: "bag", "db3" or "mcap"."""

    def __init__(self, kind: str) -> None:
        self.kind, self.store = kind, STORES[kind]

    def make(self, name: str, *values: Any, **named: Any) -> Any:
        package, short = name.split("/")
        return self.store.types[f"{package}/msg/{short}"](*values, **named)

    def header(self, time: int, frame: str) -> Any:
        stamp = self.make("builtin_interfaces/Time", time // 10**9, time % 10**9)
        number = {"seq": 0} if self.kind == "bag" else {}
        return self.make("std_msgs/Header", **number, stamp=stamp, frame_id=frame)

    def laser(self, time: int, ranges: Any, first: float = -1.5, step: float = 0.01) -> Any:
        readings = np.asarray(ranges, np.float32)
        return self.make(
            "sensor_msgs/LaserScan", self.header(time, "laser"), first,
            first + step * (len(readings) - 1), step, 0.0, 0.1, 0.05, 30.0, readings,
            np.zeros(0, np.float32),
        )  # fmt: skip

    def cloud(
        self, time: int, points: Any, code: str = "<f4", pad: int = 4, rows: int = 1, tail: int = 0
    ) -> Any:
        """Points in ``rows``, x, y, z as ``code`` behind ``pad`` bytes, ``tail`` behind a row."""
        kind = {"f4": 7, "f8": 8}[code[1:]]
        size = np.dtype(code).itemsize
        layout = np.dtype(
            {
                "names": list("xyz"),
                "formats": [code] * 3,
                "offsets": [pad, pad + size, pad + 2 * size],
                "itemsize": pad + 3 * size + 2,
            }
        )
        grid = np.zeros(len(points), layout)
        for name, column in zip("xyz", np.asarray(points).T, strict=True):
            grid[name] = column
        width = len(points) // rows
        raw = grid.view(np.uint8).reshape(rows, width * layout.itemsize)
        raw = np.pad(raw, ((0, 0), (0, tail)))
        fields = [
            self.make("sensor_msgs/PointField", name, pad + i * size, kind, 1)
            for i, name in enumerate("xyz")
        ]
        return self.make(
            "sensor_msgs/PointCloud2", self.header(time, "laser"), rows, width, fields,
            code[0] == ">", layout.itemsize, raw.shape[1], raw.ravel(), True,
        )  # fmt: skip

    def _pose(self, xyz: Any, q: Any, vector: str) -> tuple[Any, Any]:
        return (
            self.make(f"geometry_msgs/{vector}", *map(float, xyz)),
            self.make("geometry_msgs/Quaternion", *map(float, q)),
        )

    def odometry(self, time: int, xyz: Any, q: Any = (0, 0, 0, 1), child: str = "base") -> Any:
        pose = self.make("geometry_msgs/Pose", *self._pose(xyz, q, "Point"))
        zero = self.make("geometry_msgs/Vector3", 0.0, 0.0, 0.0)
        twist = self.make("geometry_msgs/Twist", zero, zero)
        return self.make(
            "nav_msgs/Odometry", self.header(time, "odom"), child,
            self.make("geometry_msgs/PoseWithCovariance", pose, np.zeros(36)),
            self.make("geometry_msgs/TwistWithCovariance", twist, np.zeros(36)),
        )  # fmt: skip

    def tf(self, time: int, parent: str, child: str, xyz: Any, q: Any = (0, 0, 0, 1)) -> Any:
        moved = self.make("geometry_msgs/Transform", *self._pose(xyz, q, "Vector3"))
        one = self.make("geometry_msgs/TransformStamped", self.header(time, parent), child, moved)
        return self.make("tf2_msgs/TFMessage", [one])

    def write(self, path: Path, entries: list[Entry], **how: Any) -> Path:
        """Write a bag; ROS 2 makes a folder, of which the path of the one file is given."""
        if self.kind == "bag":
            writer: Any = rosbag1.Writer(path)
            if how:
                writer.set_compression(how["compression"])
        else:
            plugin = StoragePlugin.MCAP if self.kind == "mcap" else StoragePlugin.SQLITE3
            writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
        with writer:
            known: dict[str, Any] = {}
            for topic, time, message in entries:
                name = message.__msgtype__
                if topic not in known:
                    known[topic] = writer.add_connection(topic, name, typestore=self.store)
                pack = self.store.serialize_cdr
                if self.kind == "bag":
                    pack = self.store.serialize_ros1
                writer.write(known[topic], time, pack(message, name))
        return path if self.kind == "bag" else next(path.glob(f"*.{self.kind}"))


def drive(make: Messages, scans: list[Any], lag: int = 0) -> list[Entry]:
    """Scans every 0.1 s, odometry 0.1 m apart half-way between them, the laser 0.2 m ahead."""
    entries: list[Entry] = [
        ("/tf_static", START - 10**8, make.tf(START, "base", "laser", (0.2, 0, 0.5)))
    ]
    for i in range(-1, len(scans)):
        time = START + i * 10**8
        if i >= 0:
            entries.append(("/scan", time + lag, scans[i]))
        odometry = make.odometry(time + 5 * 10**7, (0.1 * i + 0.05, 0, 0))
        entries.append(("/odom", time + 5 * 10**7, odometry))
    return entries
