"""Read one point cloud file (.ply, .pcd, .bin, .npy), or say what is wrong with it.

Open3D answers a bad file with a warning and an empty cloud, a PLY file that was cut off with
points of uninitialised memory, and a cut off ASCII PCD file with no warning at all. So the header
is read first, binary sizes are compared with it, and ASCII bodies are parsed by numpy.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.open3d_library import open3d
from rbtm_bench.core.types import Array

SUFFIXES = (".ply", ".pcd", ".bin", ".npy")

KITTI_ROW_BYTES = 16
"""x, y, z, intensity as float32."""

MAX_HEADER_LINES = 1000
MAX_HEADER_LINE = 10_000

PLY_BYTES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "int32", "uint32", "float", "float32"), 4),
    **dict.fromkeys(("double", "float64", "int64", "uint64"), 8),
}


@dataclass
class Header:
    """What a PLY or PCD header says: encoding, points, the columns of x, y, z, bytes a point."""

    encoding: str = ""
    count: int = -1
    columns: dict[str, int] = field(default_factory=dict)
    row_bytes: int = 0
    end: int = 0


def check_file(path: Path) -> None:
    """Raise ``DataError`` for what can be seen without reading the points."""
    try:
        size = path.stat().st_size
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or error}") from None
    if size == 0:
        raise DataError(f"{path}: the file is empty")
    suffix = path.suffix.lower()
    if suffix == ".bin" and size % KITTI_ROW_BYTES:
        raise DataError(
            f"{path}: expected float32 x y z intensity, but {size} bytes are not a multiple of "
            f"{KITTI_ROW_BYTES}"
        )
    if suffix == ".npy":
        _open_npy(path)


def read_points(path: Path) -> Array:
    """All points (N, 3) m of the file, non-finite ones included. Raises ``DataError``."""
    check_file(path)
    suffix = path.suffix.lower()
    try:
        if suffix == ".bin":
            return np.fromfile(path, dtype=np.float32).reshape(-1, 4)[:, :3].astype(np.float64)
        if suffix == ".npy":
            return np.array(_open_npy(path)[:, :3], dtype=np.float64)
        header = _ply_header(path) if suffix == ".ply" else _pcd_header(path)
        points = (
            _ascii_points(path, header)
            if header.encoding == "ascii"
            else _open3d_points(path, header)
        )
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or error}") from None
    if len(points) != header.count:
        raise DataError(f"{path}: {header.count} points announced, {len(points)} readable")
    return points


def _open_npy(path: Path) -> np.ndarray[tuple[int, ...], np.dtype[np.generic]]:
    """The array of a .npy file, mapped and not read."""
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise DataError(f"{path}: not a readable .npy array ({error})") from None
    if not isinstance(array, np.ndarray) or array.ndim != 2 or array.shape[1] < 3:
        shape = getattr(array, "shape", "no array")
        raise DataError(f"{path}: expected an array (N, 3) or wider, found {shape}")
    if array.dtype.kind not in "fiu":
        raise DataError(f"{path}: expected real numbers, found {array.dtype}")
    return array


def _header_lines(path: Path, last: str) -> tuple[list[list[str]], int]:
    """The header's words line by line up to the line that starts with ``last``, and its end."""
    lines: list[list[str]] = []
    with path.open("rb") as file:
        while len(lines) < MAX_HEADER_LINES:
            line = file.readline(MAX_HEADER_LINE)
            words = line.decode("latin-1").split()
            lines.append(words)
            if words and words[0] == last:
                return lines, file.tell()
            if not line:
                break
    raise DataError(f"{path}: no {path.suffix.lower()[1:].upper()} header ({last} not found)")


def _ply_header(path: Path) -> Header:
    lines, end = _header_lines(path, "end_header")
    header = Header(end=end)
    elements = 0
    if lines[0] != ["ply"]:
        raise DataError.at(path, 1, "header", "ply")
    for number, words in enumerate(lines, start=1):
        match words:
            case ["format", encoding, _]:
                header.encoding = encoding
            case ["element", name, count]:
                elements += 1
                if name == "vertex":
                    header.count = _count(path, number, count)
                    if elements > 1:
                        raise DataError.at(path, number, "header", "vertex as the first element")
            case ["property", kind, name] if elements == 1:
                header.columns[name] = len(header.columns)
                if kind not in PLY_BYTES:
                    raise DataError.at(path, number, "header", f"a type of PLY, {kind!r} found")
                header.row_bytes += PLY_BYTES[kind]
            case ["property", "list", *_] if elements == 1:
                raise DataError.at(path, number, "header", "no list among the vertex properties")
    return _complete(path, header, ("ascii", "binary_little_endian", "binary_big_endian"))


def _pcd_header(path: Path) -> Header:
    lines, end = _header_lines(path, "DATA")
    header = Header(end=end)
    fields: list[str] = []
    widths: list[int] = []
    for number, words in enumerate(lines, start=1):
        match words:
            case ["FIELDS", *names]:
                fields = names
            case ["COUNT", *counts]:
                widths = [_count(path, number, count) for count in counts]
            case ["POINTS", count]:
                header.count = _count(path, number, count)
            case ["DATA", encoding]:
                header.encoding = encoding
    widths = widths or [1] * len(fields)
    if len(widths) != len(fields):
        raise DataError(f"{path}: {len(fields)} FIELDS but {len(widths)} COUNT in the header")
    starts = np.cumsum([0, *widths[:-1]])
    header.columns = {name: int(start) for name, start in zip(fields, starts, strict=False)}
    return _complete(path, header, ("ascii", "binary", "binary_compressed"))


def _count(path: Path, line: int, word: str) -> int:
    if not word.isdecimal() or len(word) > 18:
        raise DataError.at(path, line, "header", f"a count, {word[:20]!r} found")
    return int(word)


def _complete(path: Path, header: Header, encodings: tuple[str, ...]) -> Header:
    if header.encoding not in encodings:
        raise DataError(
            f"{path}: encoding {header.encoding!r} in the header is none of {encodings}"
        )
    if header.count < 0 or not {"x", "y", "z"} <= header.columns.keys():
        raise DataError(f"{path}: the header must give a number of points and x, y, z")
    return header


def _ascii_points(path: Path, header: Header) -> Array:
    body = path.read_bytes()[header.end :].decode("latin-1")
    if header.count == 0 or not body.strip():
        return np.empty((0, 3))
    columns = [header.columns[name] for name in "xyz"]
    try:
        # Splitting at \n only keeps the row numbers of a message right.
        return np.loadtxt(
            body.split("\n"), usecols=columns, ndmin=2, comments=None, max_rows=header.count
        )
    except ValueError as error:
        raise DataError(f"{path}: in the points, {error}") from None


def _open3d_points(path: Path, header: Header) -> Array:
    needed = header.end + header.count * header.row_bytes
    size = os.path.getsize(path)
    if size < needed:
        raise DataError(f"{path}: truncated, {size} bytes of {needed}")
    o3d = open3d()

    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        cloud = o3d.io.read_point_cloud(path)
    return np.array(cloud.points, dtype=np.float64)
