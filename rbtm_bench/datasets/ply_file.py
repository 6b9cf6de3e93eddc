"""PLY files: any elements and properties, lists among them, ASCII and both byte orders."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.cloud_header import (
    announced,
    ascii_columns,
    ascii_rows,
    count,
    header_lines,
)
from rbtm_bench.datasets.files import file_size

TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
    "int64": "i8",
    "uint64": "u8",
}
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass
class Element:
    """An element of a PLY file: its name, how many there are, and its properties in order: name,
    type, and for a list the type of its length, else None."""

    name: str
    count: int
    properties: list[tuple[str, str, str | None]] = field(default_factory=list)

    @property
    def has_lists(self) -> bool:
        """Whether records may differ in length."""
        return any(length is not None for _, _, length in self.properties)

    def least(self, ascii_words: bool) -> int:
        """Bytes of a record at least."""
        if ascii_words:
            return 2 * len(self.properties)
        return sum(np.dtype(length or kind).itemsize for _, kind, length in self.properties)


def read_ply(path: Path) -> Array:
    """The vertices (N, 3), in the file's own unit. Raises ``DataError`` for whatever is wrong."""
    encoding, elements, end = read_header(path)
    is_ascii = encoding == "ascii"
    before: list[Element] = []
    for element in elements:
        if element.name == "vertex":
            break
        before.append(element)
    available = file_size(path) - end
    least = sum(one.count * one.least(is_ascii) for one in elements) - is_ascii
    alone = len(elements) == 1 and not element.has_lists
    announced(path, element.count, least, available, exact=alone and not is_ascii)
    if is_ascii:
        return _ascii(path, elements, element, before, end)
    content, order = path.read_bytes()[end:], ORDERS[encoding]
    points, at = _binary(content, path, element, before, order)
    for other in elements[len(before) + 1 :]:
        at = _behind(content, at, path, other, order)
    if content[at:].strip():
        raise DataError(f"{path}: {len(content) - at} bytes more than the elements announced")
    return points


def read_header(path: Path) -> tuple[str, list[Element], int]:
    """Encoding, elements and the end of the header, checked."""
    lines, end = header_lines(path, "end_header")
    if lines[0] != ["ply"]:
        raise DataError.at(path, 1, "header", "ply")
    encoding, elements = "", list[Element]()
    for number, words in enumerate(lines, start=1):
        match words:
            case ["format", word, _]:
                encoding = word
            case ["element", name, word]:
                elements.append(Element(name, count(path, number, word)))
            case ["property", "list", length, kind, name] if elements:
                _known(path, number, length, kind)
                elements[-1].properties.append((name, TYPES[kind], TYPES[length]))
            case ["property", kind, name] if elements:
                _known(path, number, kind)
                elements[-1].properties.append((name, TYPES[kind], None))
    if encoding not in ("ascii", *ORDERS):
        raise DataError(
            f"{path}: encoding {encoding[:20]!r} in the header is none of ascii, "
            + ", ".join(ORDERS)
        )
    vertices = [element for element in elements if element.name == "vertex"]
    scalars = [n for v in vertices for n, _, length in v.properties if length is None]
    if len(vertices) != 1 or any(scalars.count(name) != 1 for name in "xyz"):
        raise DataError(f"{path}: the header must give a number of points and x, y, z")
    return encoding, elements, end


def _known(path: Path, line: int, *kinds: str) -> None:
    for kind in kinds:
        if kind not in TYPES:
            raise DataError.at(path, line, "header", f"a type of PLY, {kind[:20]!r} found")


def _ascii(
    path: Path, elements: list[Element], vertex: Element, before: list[Element], end: int
) -> Array:
    rows = ascii_rows(path, end)
    expected = sum(element.count for element in elements)
    first = sum(element.count for element in before)
    if len(rows) != expected:
        readable = min(max(len(rows) - first, 0), vertex.count) if len(rows) < expected else None
        found = f"{len(rows)} lines for {expected}" if readable is None else f"{readable} readable"
        raise DataError(f"{path}: {vertex.count} points announced, {found}")
    rows = rows[first : first + vertex.count]
    names = [name for name, _, _ in vertex.properties]
    if vertex.has_lists:
        rows = [_unlisted(path, n, row, vertex) for n, row in enumerate(rows)]
        names = [name for name, _, length in vertex.properties if length is None]
    short = next((n for n, row in enumerate(rows) if len(row.split()) != len(names)), None)
    if short is not None:
        found = str(len(rows[short].split()))
        raise DataError(f"{path}: point {short}: {len(names)} numbers expected, {found} found")
    return ascii_columns(path, rows, [names.index(name) for name in "xyz"])


def _unlisted(path: Path, number: int, row: bytes, vertex: Element) -> bytes:
    """A row without its lists."""
    words, kept, at = row.split(), list[bytes](), 0
    for _, _, length in vertex.properties:
        if at >= len(words):
            break
        if length is None:
            kept.append(words[at])
            at += 1
        else:
            at += 1 + count(path, number, words[at].decode("latin-1"))
    if at != len(words):
        raise DataError(f"{path}: point {number}: {at} numbers expected, {len(words)} found")
    return b" ".join(kept)


def _binary(
    content: bytes, path: Path, vertex: Element, before: list[Element], order: str
) -> tuple[Array, int]:
    """The vertices, and where they end."""
    at = 0
    for element in before:
        at = _behind(content, at, path, element, order)
    if not vertex.has_lists:
        kinds = [(f"{i}", order + kind) for i, (_, kind, _) in enumerate(vertex.properties)]
        dtype = np.dtype(kinds)
        announced(path, vertex.count, vertex.count * dtype.itemsize, len(content) - at, exact=False)
        rows = np.frombuffer(content, dtype, vertex.count, at)
        names = [name for name, _, _ in vertex.properties]
        columns = [rows[f"{names.index(name)}"].astype(np.float64) for name in "xyz"]
        return np.column_stack(columns), at + vertex.count * dtype.itemsize
    points = np.empty((vertex.count, 3))
    for row in range(vertex.count):
        at = _record(content, at, path, vertex, order, points[row])
    return points, at


def _behind(content: bytes, at: int, path: Path, element: Element, order: str) -> int:
    """Where the records of an element end."""
    if not element.has_lists:
        return at + element.count * element.least(False)
    for _ in range(element.count):
        at = _record(content, at, path, element, order, None)
    return at


def _record(
    content: bytes, at: int, path: Path, element: Element, order: str, point: Array | None
) -> int:
    """Where a record ends; its x, y, z go into ``point``."""
    for name, kind, length in element.properties:
        times = 1
        if length is not None:
            times = int(_number(content, at, path, order + length))
            at += np.dtype(length).itemsize
        elif point is not None and name in "xyz":
            point["xyz".index(name)] = _number(content, at, path, order + kind)
        size = np.dtype(kind).itemsize * times
        if not 0 <= size <= len(content) - at:
            raise DataError(f"{path}: truncated in element {element.name}")
        at += size
    return at


def _number(content: bytes, at: int, path: Path, dtype: str) -> float:
    if at + np.dtype(dtype).itemsize > len(content):
        raise DataError(f"{path}: truncated")
    return float(np.frombuffer(content, dtype, 1, at)[0])
