"""The words of the command line, as they are typed: paths and names need no quotes.

Hydra reads 2011_09_26 as a number, and no umlaut or ~ at all. Settings that are text are quoted
for it; a path without "=" in front becomes the settings that read it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection

TEXT = frozenset(
    {
        "dataset.path",
        "dataset.poses",
        "dataset.relations",
        "dataset.odometry",
        "dataset.pattern",
        "dataset.topic",
        "dataset.odometry_topic",
        "dataset.truth_topic",
        "dataset.odometry_frame",
        "dataset.truth_frame",
        "selector.gaps_from",
        "selector.gaps_sha256",
        "pairs.folder",
        "out",
    }
)
"""The settings that are paths, names or patterns."""

_PLAIN = re.compile(r"[A-Za-z/.][\w/.\-+:@%*]*", re.ASCII)
_NOT_TEXT = re.compile(r"null|true|false|inf|nan", re.IGNORECASE)
_HYDRA = re.compile(r"['\"\[{]|.*\$\{|(glob|choice|range|interval|sort|shuffle|tag|str)\(")


def as_typed(words: list[str]) -> list[str]:
    """The words with text quoted where Hydra would take it for something else."""
    return [_quoted(word) for word in words]


def _quoted(word: str) -> str:
    key, equals, value = word.partition("=")
    if not equals or key.strip() not in TEXT or not value:
        return word
    if _HYDRA.match(value.lstrip()) or value == "null":
        return word
    return f"{key}={','.join(as_text(part) for part in value.split(','))}"


def as_text(value: str) -> str:
    """One value, home folder put in, as Hydra reads it as text."""
    if value.startswith("~"):
        value = os.path.expanduser(value)
    if _PLAIN.fullmatch(value) and not _NOT_TEXT.fullmatch(value):
        return value
    escaped = value.replace("'", "\\'")
    return f"'{escaped}'"


def with_data(words: list[str]) -> list[str]:
    """The words, where the first is a path, with the settings that read what is there instead.

    Raises ``DataError`` for data that are not recognised.
    """
    keys = [word.partition("=")[0] for word in words[1:]]
    return [*data_words(words[0], keys), *words[1:]]


def data_words(path: str, keys: Collection[str]) -> list[str]:
    """The settings that read the data at ``path``, but for those whose ``keys`` are given anyway.

    Raises ``DataError`` for data that are not recognised.
    """
    from rbtm_bench.datasets.recognise import recognise

    found = recognise(path, tuple(keys))
    if "dataset" in keys:
        found = {"dataset.path": path}
    return [f"{key}={value}" for key, value in found.items() if key not in keys]
