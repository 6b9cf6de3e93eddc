"""Read files so that whatever is wrong with them becomes one line that says where."""

from __future__ import annotations

import bz2
import gzip
import hashlib
import math
import zlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from rbtm_bench.core.errors import DataError


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


def unpacked_lines(path: str | Path, digest: hashlib._Hash) -> Iterator[bytes]:
    """The lines of a file, unpacked on the way, so that a long log never is in memory as a whole.

    ``digest`` sees the unpacked content. Raises ``DataError`` as ``read_bytes`` does, where the
    damage is met.
    """
    try:
        with open(path, "rb") as file:
            magic = file.read(3)
            file.seek(0)
            unpacked: Iterable[bytes] = file
            if magic.startswith(b"\x1f\x8b"):
                unpacked = gzip.GzipFile(fileobj=file)
            elif magic.startswith(b"BZh"):
                unpacked = bz2.BZ2File(file)
            blank = True
            for line in unpacked:
                digest.update(line)
                blank = blank and not line.strip()
                yield line
    except IsADirectoryError:
        raise DataError(f"{path}: expected a file, found a folder") from None
    except (EOFError, ValueError, zlib.error, gzip.BadGzipFile) as error:
        raise DataError(f"{path}: damaged or truncated archive ({error})") from None
    except OSError as error:
        if error.errno is None:  # bz2 reports damage so
            raise DataError(f"{path}: damaged or truncated archive ({error})") from None
        raise DataError(f"{path}: {error.strerror or error}") from None
    if blank:
        raise DataError(f"{path}: the file is empty")


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
        raise DataError.at(path, line, field, f"a number, {quoted(bad)}") from None
    if finite and not all(map(math.isfinite, values)):
        bad = next(w for w, v in zip(words, values, strict=True) if not math.isfinite(v))
        raise DataError.at(path, line, field, f"a finite number, {quoted(bad)}")
    return values


def quoted(word: bytes) -> str:
    """How a message quotes what stands in a file."""
    text = word[:20].decode("ascii", "backslashreplace")
    return f"{text!r} found" if text else "none found"


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
