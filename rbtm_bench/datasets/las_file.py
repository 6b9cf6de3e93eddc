"""LAS files (ASPRS) and their packed form LAZ, by laspy; the header is held against the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.cloud_header import announced
from rbtm_bench.datasets.files import file_size

SUFFIXES = (".las", ".laz")
PACKED_TIMES = 100
"""A packed point takes at least this part of a plain one."""
FARTHEST_UNIT = 1e3
"""m; the unit of the integers that coordinates are."""


def read_las(path: Path) -> Array:
    """Points (N, 3), in the file's own unit and frame: integers by scale and offset.

    Raises ``ConfigError`` where laspy is not installed, ``DataError`` for whatever is wrong.
    """
    try:
        import laspy
    except ImportError:
        raise ConfigError(f"{path}: needs laspy: pip install rbtm-bench[las]") from None
    size = file_size(path)
    with laspy.open(path) as file:
        header = file.header
        record, points = header.point_format.size, header.point_count
        packed = header.are_points_compressed
        least = points * record // (PACKED_TIMES if packed else 1)
        plain = not packed and not header.number_of_evlrs
        announced(path, points, least, size - header.offset_to_point_data, exact=plain)
        scales = np.asarray(header.scales)
        if not ((np.abs(scales) > 0) & (np.abs(scales) < FARTHEST_UNIT)).all():
            raise DataError(f"{path}: scales {scales.tolist()} in the header: expected m a unit")
        read = file.read_points(points)
        if len(read) != points:
            raise DataError(f"{path}: {points} points announced, {len(read)} readable")
        return np.column_stack([np.asarray(axis, np.float64) for axis in (read.x, read.y, read.z)])
