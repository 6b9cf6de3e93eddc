"""Which plug-ins can be used on this machine."""

from __future__ import annotations

import importlib.util
from functools import cache
from typing import Any

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.runs.plugins import is_system, locate
from rbtm_bench.runs.settings import member_nodes


def missing_library(group: str, name: str, node: dict[str, Any] | ConfigError) -> str | None:
    """Why a plug-in cannot be used here, or None."""
    if isinstance(node, ConfigError):
        return str(node)
    try:
        cls = locate(f"{group}={name}", str(node.get("_target_")))
    except ConfigError as error:
        return str(error)
    absent = [package for package in getattr(cls, "requires", ()) if not is_importable(package)]
    return f"needs {', '.join(absent)}" if absent else None


def is_importable(package: str) -> bool:
    try:
        return importlib.util.find_spec(package) is not None
    except (ImportError, ValueError):
        return False


@cache
def planar_backends(first: str = "") -> tuple[str, ...]:
    """The names of every installed backend that registers pairs of planar scans, sorted; the one
    named ``first``, if it is there, before all others. Systems and "none" are not among them."""
    names = []
    for name, node in member_nodes("backend").items():
        if name == "none" or missing_library("backend", name, node) or not isinstance(node, dict):
            continue
        made = locate(f"backend={name}", str(node["_target_"]))
        if "2d" in getattr(made, "dimensions", ()) and not is_system({"backend": node}):
            names.append(name)
    return tuple(sorted(names, key=lambda name: (name != first, name)))
