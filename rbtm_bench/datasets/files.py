"""Read files so that whatever is wrong with them becomes one line that says where."""

from __future__ import annotations

import bz2
import gzip
import math
import zlib
from collections.abc import Sequence
from pathlib import Path

from rbtm_bench.errors import DataError


def read_bytes(path: str | Path) -> bytes:
    """The content of a file, unpacked if its first bytes say gzip or bzip2.

    Raises ``DataError`` for a missing file, a folder, an empty file or a damaged archive.
    """
    try:
        content = Path(path).read_bytes()
    except IsADirectoryError:
        raise DataError(f"{path}: expected a file, found a folder") from None
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or error}") from None
    try:
        if content.startswith(b"\x1f\x8b"):
            content = gzip.decompress(content)
        elif content.startswith(b"BZh"):
            content = bz2.decompress(content)
    except (EOFError, OSError, ValueError, zlib.error) as error:
        raise DataError(f"{path}: damaged or truncated archive ({error})") from None
    if not content.strip():
        raise DataError(f"{path}: the file is empty")
    return content


def data_lines(content: bytes) -> list[tuple[int, list[bytes]]]:
    """Line numbers (from 1) and words of the lines that are neither blank nor # comments."""
    split = ((number, line.split()) for number, line in enumerate(content.split(b"\n"), start=1))
    return [(number, words) for number, words in split if words and not words[0].startswith(b"#")]


def to_numbers(
    path: str | Path, line: int, field: str, words: Sequence[bytes], finite: bool = True
) -> list[float]:
    """The words as numbers, or a ``DataError`` that names the first one that is none.

    ``finite`` also refuses NaN and infinity.
    """
    try:
        values = list(map(float, words))
    except ValueError:
        bad = next(word for word in words if not _is_number(word))
        raise DataError.at(path, line, field, f"a number, {found(bad)}") from None
    if finite and not all(map(math.isfinite, values)):
        bad = next(w for w, v in zip(words, values, strict=True) if not math.isfinite(v))
        raise DataError.at(path, line, field, f"a finite number, {found(bad)}")
    return values


def found(word: bytes) -> str:
    """How a message quotes what stands in a file."""
    text = word[:20].decode("ascii", "backslashreplace")
    return f"{text!r} found" if text else "none found"


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
