"""Read files so that whatever is wrong with them becomes one line that says where.

What a file says of itself is a claim: sizes are held against its bytes before memory is taken,
unpacking is limited, and what is no regular file (a pipe would wait for ever) is refused.
"""

from __future__ import annotations

import bz2
import functools
import gzip
import hashlib
import math
import os
import stat
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from rbtm_bench.core.errors import DataError, RbtmBenchError

P = ParamSpec("P")
R = TypeVar("R")

LONGEST_LINE = 1 << 20
"""Bytes of a line at most: 30 times a scan of 4096 beams."""
UNPACKED_ALWAYS, UNPACKED_TIMES = 64 << 20, 100
"""An archive may unpack to so many bytes, or so many times its size: logs pack to a tenth."""
WHOLE_FILE = 1 << 30
"""Bytes of a file that is read as a whole."""
BOM = b"\xef\xbb\xbf"
UTF16 = (b"\xff\xfe", b"\xfe\xff")
LARGEST_NUMBER = 1e19
"""Beyond any time (ns since 1970 have 19 digits), length or angle in a file."""


def reader(function: Callable[P, R]) -> Callable[P, R]:
    """A function of a path, then anything, that raises ``DataError`` (or another error of ours)
    and nothing else, whatever the file holds."""

    @functools.wraps(function)
    def guarded(*args: P.args, **kwargs: P.kwargs) -> R:
        path: Any = args[0]
        try:
            return function(*args, **kwargs)
        except RbtmBenchError:
            raise
        except OSError as error:
            raise DataError(f"{path}: {error.strerror or error}") from None
        except MemoryError:
            raise DataError(f"{path}: does not fit into memory") from None
        except Exception as error:
            text = " ".join(f"{type(error).__name__}: {error}".split())
            raise DataError(f"{path}: cannot be read ({text})") from error

    return guarded


def file_size(path: str | Path) -> int:
    """Bytes of a regular file, at least 1. Raises ``DataError`` for anything else."""
    try:
        state = os.stat(path)
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    if stat.S_ISDIR(state.st_mode):
        raise DataError(f"{path}: expected a file, found a folder")
    if not stat.S_ISREG(state.st_mode):
        raise DataError(f"{path}: expected a file, found a pipe or device")
    if state.st_size == 0:
        raise DataError(f"{path}: the file is empty")
    return state.st_size


@reader
def read_bytes(path: str | Path) -> bytes:
    """The content of a file, unpacked if its first bytes say gzip or bzip2, without a byte order
    mark.

    Raises ``DataError`` for a missing file, a folder, a pipe, an empty file, a damaged archive or
    one that unpacks to more than is plausible.
    """
    if file_size(path) > WHOLE_FILE:
        raise DataError(f"{path}: larger than {WHOLE_FILE} bytes, expected a short text")
    content = b"".join(unpacked_lines(path, hashlib.sha256()))
    if content.startswith(UTF16):
        try:
            return content.decode("utf-16").removeprefix("\ufeff").encode()
        except UnicodeDecodeError:
            raise DataError(f"{path}: a byte order mark of UTF-16, but no such text") from None
    return content


def unpacked_lines(path: str | Path, digest: hashlib._Hash) -> Iterator[bytes]:
    """The lines of a file, unpacked on the way, so that a long log never is in memory as a whole.

    ``digest`` sees the unpacked content; a byte order mark is left out of the lines. Raises
    ``DataError`` as ``read_bytes`` does, where the damage is met.
    """
    size = file_size(path)
    most = max(UNPACKED_ALWAYS, UNPACKED_TIMES * size)
    try:
        with open(path, "rb") as file:
            magic = file.read(3)
            file.seek(0)
            unpacked: Any = file
            if magic.startswith(b"\x1f\x8b"):
                unpacked = gzip.GzipFile(fileobj=file)
            elif magic.startswith(b"BZh"):
                unpacked = bz2.BZ2File(file)
            yield from _lines(path, unpacked, digest, most)
    except (EOFError, ValueError, zlib.error, gzip.BadGzipFile) as error:
        raise DataError(f"{path}: damaged or truncated archive ({error})") from None
    except OSError as error:
        if error.errno is None:  # bz2 reports damage so
            raise DataError(f"{path}: damaged or truncated archive ({error})") from None
        raise DataError(f"{path}: {error.strerror or error}") from None


def _lines(path: str | Path, file: Any, digest: hashlib._Hash, most: int) -> Iterator[bytes]:
    blank, total, number = True, 0, 0
    read = functools.partial(file.readline, LONGEST_LINE)
    for number, line in enumerate(iter(read, b""), start=1):
        digest.update(line)
        total += len(line)
        if len(line) == LONGEST_LINE:
            raise DataError(f"{path}, line {number}: longer than {LONGEST_LINE} bytes: no text")
        if total > most:
            raise DataError(f"{path}: unpacks to more than {most} bytes, refused")
        if number == 1 and line.startswith(BOM):
            line = line[len(BOM) :]
        blank = blank and not line.strip()
        yield line
    if blank:
        raise DataError(f"{path}: the file is empty")


def data_lines(content: bytes) -> list[tuple[int, list[bytes]]]:
    """Line numbers (from 1) and words of the lines that are neither blank nor # comments. Words
    end at blanks, or at commas or semicolons; any end of line will do."""
    content = content.removeprefix(BOM).replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"," in content or b";" in content:
        content = content.replace(b",", b" ").replace(b";", b" ")
    split = ((number, line.split()) for number, line in enumerate(content.split(b"\n"), start=1))
    return [(number, words) for number, words in split if words and not words[0].startswith(b"#")]


def comments(content: bytes) -> Iterable[str]:
    """The text of # comments, in lower case."""
    for line in content.removeprefix(BOM).splitlines():
        if line.lstrip().startswith(b"#"):
            yield line.decode("latin-1").lower()


def to_numbers(
    path: str | Path,
    line: int,
    field: str,
    words: Sequence[bytes],
    finite: bool = True,
    largest: float = LARGEST_NUMBER,
) -> list[float]:
    """The words as numbers, or a ``DataError`` that names the first one that is none.

    ``finite`` also refuses NaN, infinity and numbers beyond ``largest``.
    """
    try:
        values = list(map(float, words))
    except ValueError:
        bad = next(word for word in words if not is_number(word))
        raise DataError.at(path, line, field, f"a number, {quoted(bad)}") from None
    if b"_" in b"".join(words):  # 1_5 is a number to Python alone
        bad = next(word for word in words if b"_" in word)
        raise DataError.at(path, line, field, f"a number, {quoted(bad)}")
    if finite and not all(-largest <= value <= largest for value in values):
        word, value = next(
            (w, v) for w, v in zip(words, values, strict=True) if not -largest <= v <= largest
        )
        expected = f"at most {largest:g}" if math.isfinite(value) else "a finite number"
        raise DataError.at(path, line, field, f"{expected}, {quoted(word)}")
    return values


def quoted(word: bytes) -> str:
    """How a message quotes what stands in a file."""
    text = word[:20].decode("ascii", "backslashreplace")
    return f"{text!r} found" if text else "none found"


def is_number(word: bytes) -> bool:
    """Whether a word of a file reads as a number."""
    try:
        float(word)
    except ValueError:
        return False
    return True
