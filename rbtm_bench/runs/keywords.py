"""Settings as Python's keyword arguments: two underscores where the command line has a dot."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from typing import Any

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.types import Scan
from rbtm_bench.core.wording import suggestion
from rbtm_bench.runs.declared import FOR_PAIRS, GROUPS, PLUGIN_GROUPS, SHARED
from rbtm_bench.runs.words import as_text

FED = ("registration", "descriptor", "seed")
OF_PAIR = ("backend", "search", "registration", "judge_points", "judge_radius")
OF_METHOD = ("backend", *(name for name in FOR_PAIRS if name != "loops"), *FED)
OF_DATA = ("dataset", "seed", "replicate", "perturbation", "perturb")
"""The first words of the settings that do something for a pair, a stream of scans, a data set."""


def objects_and_names(
    settings: Mapping[str, Any], allowed: Collection[str], function: str
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The plug-ins that are given as objects, by group, and the other settings with a member in
    their place. Raises ``ConfigError`` for a setting that does nothing for ``function``."""
    given, named = {}, {}
    for name, value in settings.items():
        first = name.replace("__", ".").partition(".")[0]
        if first not in allowed and (first in GROUPS or first in SHARED):
            raise ConfigError(f"{name}: no setting of {function}.{suggestion(name, [*allowed])}")
        if name in PLUGIN_GROUPS and not isinstance(value, str):
            given[name] = value
            continue
        named[name] = value
    for name in named:
        if name.replace("__", ".").partition(".")[0] in given:
            raise ConfigError(f"{name}: expected of the object itself, which is given")
    if "backend" in given:
        named["backend"] = "none"
    if "selector" in given:
        named["selector"] = "rbtm" if given["selector"].needs_scores else "previous"
    return given, named


def of_values(settings: Mapping[str, Any], several: bool = False) -> list[str]:
    """Python's values as words: {"selector__window": 10} is ``selector.window=10``; where
    ``several`` may be given, a list of them is a comma list.

    Raises ``ConfigError`` for a value that no setting can have.
    """
    words = []
    for name, value in settings.items():
        key = name.replace("__", ".")
        value = value.tolist() if hasattr(value, "tolist") else value  # numpy's
        listed = several and isinstance(value, list | tuple | range)
        if listed and not len(value):
            raise ConfigError(f"{key}: an empty list: expected at least one value")
        values = value if listed else [value]
        words.append(f"{key}={','.join(_literal(key, one) for one in values)}")
    return words


def _literal(key: str, value: Any) -> str:
    """A value as Hydra reads it."""
    value = value.tolist() if hasattr(value, "tolist") else value
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str | os.PathLike):
        return as_text(os.fspath(value))
    if isinstance(value, list | tuple | range):
        return f"[{','.join(_literal(key, one) for one in value)}]"
    if isinstance(value, Mapping):
        return "{" + ",".join(f"{k}:{_literal(key, one)}" for k, one in value.items()) + "}"
    raise ConfigError(f"{key}: {type(value).__name__}: expected text, a number, a list or None")


def defaults_for(scan: Scan) -> list[str]:
    """The words that suit scans like this one, of which no data set says what suits them."""
    words = ["dataset=corridor"] if scan.planar else ["dataset=cloud_folder", "dataset.path=."]
    words += ["guess=odometry"] if scan.odometry is not None else []
    return words + (["similarity=overlap"] if scan.planar and scan.ranges is None else [])
