"""Files that appear whole or not at all."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rbtm_bench.core.errors import ConfigError, WriteError


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Call ``write`` with a temporary path beside ``path``, then move it into place.

    Raises ``WriteError`` naming ``path`` where that cannot be done, as on a full disk.
    """
    partial = path.with_name(f".{os.getpid()}.partial.{path.name}")
    try:
        write(partial)
        os.replace(partial, path)
    except OSError as error:
        why = os.strerror(error.errno) if error.errno else str(error)
        raise WriteError(error.errno, why, str(path)) from error
    finally:
        partial.unlink(missing_ok=True)


def make_folder(out: Path) -> None:
    """Make the folder that ``out=`` names. Raises ``ConfigError`` where that cannot be done."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"out={out}: cannot be made: {error.strerror or error}") from error


def write_text(path: Path, text: str) -> None:
    """Write a text file in one go."""
    write_atomically(path, lambda p: p.write_text(text, encoding="utf-8"))


def write_json(path: Path, value: Any) -> None:
    """Write a JSON file in one go; numbers keep their full precision, NaN is refused."""
    write_text(path, json.dumps(value, indent=1, allow_nan=False) + "\n")
