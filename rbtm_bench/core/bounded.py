"""Files that somebody else may have written: regular ones, within bounds, read whole or refused.

What is read here answers with a value or with one ``DataError`` that names file and reason: no
reading that waits for ever (a FIFO), fills memory (a bomb of aliases or of zeros) or ends the
process (nesting deeper than the parser's stack).
"""

from __future__ import annotations

import json
import os
import re
import stat
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rbtm_bench.core.errors import DataError, one_line

if TYPE_CHECKING:
    import pyarrow as pa

TEXT = 64_000_000
"""Bytes of a text file of results; a run's largest is a trajectory: 100 bytes a scan."""
SETTINGS = 4_000_000
"""Bytes of a YAML file."""
DEEPEST = 100
"""Levels that a YAML document may be nested."""
SHALLOW = 10_000
"""Characters up to which none can be nested so deep that libyaml's recursion ends the process."""
CELLS = 200_000_000
"""Numbers that a parquet file may announce: 2 million scans of a hundred columns."""
UNPACKED_TIMES, UNPACKED_ALWAYS = 200, 64_000_000
"""Bytes that parquet columns may unpack to: so many times the file's, so many in any case."""


def size_of(path: Path, most: int = TEXT) -> int:
    """The bytes of a regular file. Raises ``DataError`` for anything else, and for more."""
    try:
        status = path.stat()
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error
    if not stat.S_ISREG(status.st_mode):
        raise DataError(f"{path}: not a regular file")
    if status.st_size > most:
        raise DataError(f"{path}: {status.st_size} bytes, at most {most} are read")
    return status.st_size


def read_bytes(path: Path, most: int = TEXT) -> bytes:
    """The content of a regular file of at most so many bytes. Raises ``DataError``."""
    size_of(path, most)
    try:
        # what became a FIFO meanwhile does not block either
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
            content = file.read(most + 1)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error
    if len(content) > most:
        raise DataError(f"{path}: more than {most} bytes")
    return content


def read_text(path: Path, most: int = TEXT) -> str:
    """The same as UTF-8 text. Raises ``DataError``."""
    try:
        return read_bytes(path, most).decode("utf-8")
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: not UTF-8 text: {error.reason}") from error


def read_json(path: Path) -> dict[str, Any]:
    """A JSON file that holds an object. Raises ``DataError``."""
    try:
        value = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path}: not readable as JSON: {one_line(error)}") from error
    if not isinstance(value, dict):
        raise DataError(f"{path}: expected an object")
    return value


def read_yaml(path: Path) -> dict[str, Any]:
    """A YAML file that holds a mapping, its numbers as OmegaConf reads them. Aliases, which can
    make a line of text a billion values, are refused. Raises ``DataError``."""
    import yaml

    text = read_text(path, SETTINGS)
    try:
        if len(text) > SHALLOW or ("&" in text and "*" in text):
            _hold_to_bounds(path, text)
        value = yaml.load(text, _loader())
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        words = one_line(error) or type(error).__name__
        raise DataError(f"{path}: not readable as YAML: {words}") from error
    if not isinstance(value, dict):
        raise DataError(f"{path}: expected a mapping")
    return {str(key): item for key, item in value.items()}


def _hold_to_bounds(path: Path, text: str) -> None:
    import yaml

    depth = 0
    for event in yaml.parse(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
        if isinstance(event, yaml.AliasEvent):
            raise DataError(f"{path}: line {event.start_mark.line + 1}: aliases are not read")
        opens = isinstance(event, yaml.CollectionStartEvent)
        depth += opens - isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST:
            raise DataError(f"{path}: nested deeper than {DEEPEST} levels")


@cache
def _loader() -> Any:
    """libyaml's safe loader with OmegaConf's own readings: 1e-5 is a number, a date is text.

    OmegaConf's takes 6 ms for a run's settings, this one 0.3 ms.
    """
    import yaml

    fast = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # without libyaml: the slow one
    loader: Any = type("Loader", (fast,), {})
    plain_exponent = re.compile(r"[-+]?[0-9]+\.?[eE][-+]?[0-9]+$")
    loader.add_implicit_resolver("tag:yaml.org,2002:float", plain_exponent, list("-+0123456789"))
    loader.yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in resolvers if not tag.endswith(":timestamp")]
        for first, resolvers in loader.yaml_implicit_resolvers.items()
    }
    return loader


def read_parquet(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """The columns (those that it has; None: all) of a parquet file that neither announces nor
    unpacks to more than its size explains. Raises ``DataError``."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    size = size_of(path, most=4_000_000_000)
    try:
        with pq.ParquetFile(path) as file:
            about = file.metadata
            groups = [about.row_group(i) for i in range(about.num_row_groups)]
            columns_of = [g.column(i) for g in groups for i in range(g.num_columns)]
            unpacked = sum(column.total_uncompressed_size for column in columns_of)
            cells = about.num_rows * about.num_columns
            if cells > CELLS or unpacked > UNPACKED_TIMES * size + UNPACKED_ALWAYS:
                what = f"{about.num_rows} rows, {unpacked} bytes"
                raise DataError(f"{path}: announces {what} in a file of {size}: refused")
            names = set(file.schema_arrow.names)
            wanted = None if columns is None else [c for c in columns if c in names]
            return file.read(columns=wanted, use_threads=False)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise DataError(f"{path}: not a readable table: {one_line(error)}") from error
