"""Clouds in text (.xyz, .csv, .txt): a point a line, numbers in columns, perhaps their names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.files import data_lines, is_number, quoted, read_bytes, to_numbers

Row = tuple[int, list[bytes]]


def read_text(path: Path, columns: Sequence[int] | None) -> tuple[Array, bool]:
    """Columns of a table of numbers, NaN and infinity among them: those asked for, those that the
    first line calls x, y, z, or all; True if they are known to be x, y, z.

    A first line of names is left out, and so is one that is the number of the others. Raises
    ``DataError`` with file and line.
    """
    rows = data_lines(read_bytes(path))
    if len(rows) > 1 and len(rows[0][1]) == 1 and rows[0][1][0] == str(len(rows) - 1).encode():
        rows = rows[1:]
    names = [word.strip(b'"').lower() for word in rows[0][1]] if rows else []
    if names and not any(is_number(word) for word in names):
        rows = rows[1:]
        if columns is None and all(name in names for name in (b"x", b"y", b"z")):
            columns = [names.index(name) for name in (b"x", b"y", b"z")]
    if not rows:
        raise DataError(f"{path}: no point in the file")
    wide = len(rows[0][1])
    if columns is not None and max(columns) >= wide:
        raise DataError(f"{path}: {wide} columns, but columns={list(columns)}")
    if wide < 3:
        raise DataError.at(path, rows[0][0], "point", f"x y z, {quoted(b' '.join(rows[0][1]))}")
    for line, words in rows:
        if len(words) != wide:
            raise DataError.at(path, line, "point", f"{wide} numbers, {len(words)} found")
    return _numbers(path, rows, columns or range(wide)), columns is not None


def _numbers(path: Path, rows: list[Row], columns: Sequence[int]) -> Array:
    try:
        picked = np.array([[words[column] for column in columns] for _, words in rows])
        if b"_" in picked.tobytes():
            raise ValueError
        return picked.astype(np.float64)
    except ValueError:
        values = [
            to_numbers(path, line, "point", [words[column] for column in columns], finite=False)
            for line, words in rows
        ]
        return np.array(values)
