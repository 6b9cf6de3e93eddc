"""What PLY and PCD headers have in common: lines of words, and counts that are claims."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.files import file_size

MAX_HEADER_LINES = 1000
MAX_HEADER_LINE = 10_000


def header_lines(path: Path, last: str) -> tuple[list[list[str]], int]:
    """The header's words line by line up to the line that starts with ``last``, and its end."""
    lines: list[list[str]] = []
    file_size(path)
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


def count(path: Path, line: int, word: str) -> int:
    """A word of a header as a count."""
    if not (word.isascii() and word.isdecimal()) or len(word) > 18:
        raise DataError.at(path, line, "header", f"a count, {word[:20]!r} found")
    return int(word)


def announced(path: Path, points: int, size: int, available: int, exact: bool = True) -> None:
    """Hold ``points`` that take ``size`` bytes against those that the file has left: fewer are
    refused, and, where nothing else may follow (``exact``), more as well."""
    if size > available:
        raise DataError(
            f"{path}: truncated, {points} points announced take {size} bytes, {available} are left"
        )
    if exact and points and available - size >= min(max(size // points, 4), 64):
        raise DataError(f"{path}: {available - size} bytes more than {points} points announced")


def ascii_rows(path: Path, end: int) -> list[bytes]:
    """The lines behind a header, blank ones left out."""
    body = path.read_bytes()[end:].replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return [line for line in body.split(b"\n") if line.strip()]


def ascii_columns(path: Path, rows: list[bytes], columns: list[int]) -> Array:
    """Columns (N, K) of rows of numbers; rows may differ in length."""
    if not rows:
        return np.empty((0, len(columns)))
    try:
        text = [row.decode("latin-1") for row in rows]
        if any("_" in row for row in text):
            raise ValueError("a number with _ in it")
        return np.loadtxt(text, usecols=columns, ndmin=2, comments=None)
    except ValueError as error:
        raise DataError(f"{path}: in the points, {error}") from None
