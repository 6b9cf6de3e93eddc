"""Scans out of messages: sensor_msgs/LaserScan and sensor_msgs/PointCloud2."""

from __future__ import annotations

from typing import Any

import numpy as np

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.types import Array

LASER, CLOUD = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/PointCloud2"
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""PointField's types as numpy's."""
TURN = 2.0 * np.pi + 0.1
"""rad; beams span at most one turn, and the rounding of single precision."""
ROUND_DEG = (0.25, 0.5, 1.0)
"""Spacings of lasers that are given by their number of beams."""
NEARLY, SAME = 0.01, 1e-4


def laser_geometry(where: str, message: Any) -> tuple[float, float, int]:
    """First angle and spacing (rad) of the beams and their number. Raises ``DataError``."""
    first, spacing = float(message.angle_min), float(message.angle_increment)
    beams = len(message.ranges)
    if beams == 0:
        raise DataError(f"{where}: no beams")
    plausible = abs(first) <= TURN and abs(spacing) * (beams - 1) <= TURN
    if not plausible or (beams > 1 and spacing == 0):
        raise DataError(f"{where}: {beams} beams from {first:.4g} rad on by {spacing:.4g} rad")
    return first, spacing, beams


def spacing_suspicion(first: float, spacing: float, beams: int) -> list[str]:
    """A word on n beams that are spread over the turn of n - 1 spacings too wide by one."""
    degrees = abs(np.rad2deg(spacing))
    for known in ROUND_DEG:
        if (
            SAME < abs(degrees / known - 1) < NEARLY
            and abs(degrees * (beams - 1) / beams / known - 1) < SAME
        ):
            return [
                f"{beams} beams are {degrees:.6g} deg apart, where lasers have {known:g}: spread "
                f"over one spacing too many? dataset.angles=[{np.rad2deg(first):.6g},{known:g}]"
            ]
    return []


def cloud_points(where: str, message: Any) -> Array:
    """All points (N, 3) m of a PointCloud2, in its order, non-finite ones included.

    Any layout of fields, organised (rows may be padded), either byte order. Raises ``DataError``
    for sizes that do not fit together.
    """
    height, width = int(message.height), int(message.width)
    step, row = int(message.point_step), int(message.row_step)
    data = np.ascontiguousarray(message.data).view(np.uint8)
    order = ">" if message.is_bigendian else "<"
    fields = {str(f.name): f for f in message.fields}
    missing = [name for name in "xyz" if name not in fields]
    if missing or len(fields) != len(message.fields):
        names = ", ".join(str(f.name) for f in message.fields)
        raise DataError(f"{where}: expected the fields x, y, z, found {names or 'none'}")
    formats, offsets = [], []
    for name in "xyz":
        one = fields[name]
        kind = TYPES.get(int(one.datatype))
        if kind is None or int(one.count) not in (0, 1):
            what = f"type {one.datatype} and count {one.count}"
            raise DataError(f"{where}: field {name} of {what}")
        if int(one.offset) + np.dtype(kind).itemsize > step:
            raise DataError(f"{where}: field {name} at {one.offset} in a point of {step} bytes")
        formats.append(order + kind)
        offsets.append(int(one.offset))
    if height <= 1 and row < width * step:
        row = width * step  # some drivers leave it out
    if row < width * step or height * row != len(data):
        raise DataError(
            f"{where}: {height} x {width} points of {step} bytes in rows of {row} announced, "
            f"{len(data)} bytes found"
        )
    layout = np.dtype(
        {"names": list("xyz"), "formats": formats, "offsets": offsets, "itemsize": step}
    )
    grid: Any = np.ndarray((height, width), layout, data.data, 0, (row, step))
    return np.stack([grid[name].astype(np.float64).ravel() for name in "xyz"], axis=1)
