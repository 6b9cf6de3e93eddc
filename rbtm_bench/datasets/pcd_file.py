"""PCD files (Point Cloud Library): any field layout, ASCII, binary or compressed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.types import Array
from rbtm_bench.datasets import lzf
from rbtm_bench.datasets.cloud_header import (
    announced,
    ascii_columns,
    ascii_rows,
    count,
    header_lines,
)
from rbtm_bench.datasets.files import file_size

TYPES = {"F": {4: "<f4", 8: "<f8"}, "I": {1: "<i1", 2: "<i2", 4: "<i4", 8: "<i8"}}
TYPES["U"] = {size: name.replace("i", "u") for size, name in TYPES["I"].items()}


@dataclass(frozen=True)
class Header:
    """Encoding, number of points, fields by name (offset in the record in bytes and in columns,
    type, count), bytes and columns of a record, and where the header ends."""

    encoding: str
    points: int
    fields: dict[str, tuple[int, int, str, int]]
    record: int
    columns: int
    end: int


def read_pcd(path: Path) -> Array:
    """Points (N, 3), in the file's own unit. Raises ``DataError`` for whatever is wrong."""
    header = read_header(path)
    if header.encoding == "ascii":
        return _ascii(path, header)
    content = path.read_bytes()[header.end :]
    if header.encoding == "binary":
        announced(path, header.points, header.points * header.record, len(content))
        raw = np.frombuffer(content, np.uint8)[: header.points * header.record]
        rows = raw.reshape(header.points, header.record)
        return np.column_stack([_field(rows, header, name) for name in "xyz"])
    return _compressed(path, header, content)


def read_header(path: Path) -> Header:
    """The header, checked."""
    lines, end = header_lines(path, "DATA")
    values: dict[str, list[str]] = {}
    numbers: dict[str, list[int]] = {}
    for line, words in enumerate(lines, start=1):
        if not words or words[0].startswith("#"):
            continue
        values[words[0]] = words[1:]
        if words[0] in ("SIZE", "COUNT", "WIDTH", "HEIGHT", "POINTS"):
            numbers[words[0]] = [count(path, line, word) for word in words[1:]]
    names = values.get("FIELDS", [])
    sizes, counts = numbers.get("SIZE", []), numbers.get("COUNT", [1] * len(names))
    kinds = values.get("TYPE", [])
    for what, listed in (("SIZE", sizes), ("TYPE", kinds), ("COUNT", counts)):
        if len(listed) != len(names):
            raise DataError(f"{path}: {len(names)} FIELDS but {len(listed)} {what} in the header")
    fields: dict[str, tuple[int, int, str, int]] = {}
    offset = column = 0
    for name, size, kind, times in zip(names, sizes, kinds, counts, strict=True):
        dtype = TYPES.get(kind, {}).get(size)
        if dtype is None:
            raise DataError(f"{path}: field {name} of TYPE {kind} and SIZE {size} in the header")
        if name in fields and name in "xyz":
            raise DataError(f"{path}: field {name} twice in the header")
        fields[name] = (offset, column, dtype, times)
        offset, column = offset + size * times, column + times
    encoding = " ".join(values.get("DATA", []))
    points = _points(path, numbers)
    if encoding not in ("ascii", "binary", "binary_compressed"):
        raise DataError(
            f"{path}: encoding {encoding[:20]!r} in the header is none of ascii, binary, "
            "binary_compressed"
        )
    if points is None or not {"x", "y", "z"} <= fields.keys():
        raise DataError(f"{path}: the header must give a number of points and x, y, z")
    if any(fields[name][3] != 1 for name in "xyz"):
        raise DataError(f"{path}: x, y, z must have COUNT 1")
    return Header(encoding, points, fields, offset, column, end)


def _points(path: Path, numbers: dict[str, list[int]]) -> int | None:
    """POINTS, or WIDTH times HEIGHT where it is not given; they must not differ."""
    claimed = numbers.get("POINTS", [])
    sides = [numbers[key][0] for key in ("WIDTH", "HEIGHT") if len(numbers.get(key, [])) == 1]
    grid = sides[0] * sides[1] if len(sides) == 2 else None
    points = claimed[0] if len(claimed) == 1 else grid
    if points is not None and grid is not None and points != grid:
        raise DataError(f"{path}: {points} POINTS announced, but WIDTH x HEIGHT is {grid}")
    return points


def _ascii(path: Path, header: Header) -> Array:
    least = 2 * header.columns * header.points - 1
    announced(path, header.points, least, file_size(path) - header.end, exact=False)
    rows = ascii_rows(path, header.end)
    if len(rows) != header.points:
        raise DataError(f"{path}: {header.points} points announced, {len(rows)} readable")
    short = next((n for n, row in enumerate(rows) if len(row.split()) != header.columns), None)
    if short is not None:
        found = len(rows[short].split())
        raise DataError(f"{path}: point {short}: {header.columns} numbers expected, {found} found")
    return ascii_columns(path, rows, [header.fields[name][1] for name in "xyz"])


def _field(rows: NDArray[np.uint8], header: Header, name: str) -> Array:
    offset, _, dtype, _ = header.fields[name]
    part = rows[:, offset : offset + np.dtype(dtype).itemsize]
    return np.ascontiguousarray(part).view(dtype)[:, 0].astype(np.float64)


def _compressed(path: Path, header: Header, content: bytes) -> Array:
    """Field by field, packed by LZF behind two sizes."""
    size = header.points * header.record
    if len(content) < 8:
        raise DataError(f"{path}: truncated before its packed points")
    packed, unpacked = (int(n) for n in np.frombuffer(content[:8], "<u4"))
    if unpacked != size:
        raise DataError(f"{path}: {size} bytes of points announced, {unpacked} packed")
    announced(path, header.points, packed, len(content) - 8, exact=False)
    raw = lzf.unpack(content[8 : 8 + packed], size)
    if raw is None:
        raise DataError(f"{path}: damaged: its packed points do not unpack to {size} bytes")
    columns = []
    for name in "xyz":
        offset, _, dtype, _ = header.fields[name]
        start = header.points * offset
        part = raw[start : start + header.points * np.dtype(dtype).itemsize]
        columns.append(part.view(dtype).astype(np.float64))
    return np.column_stack(columns)
