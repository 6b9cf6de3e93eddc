"""Open3D, imported in half the time: without the web framework behind one of its viewers.

``open3d.visualization.draw_plotly`` imports dash, which takes as long as all the rest and serves
nobody who registers clouds. It is loaded when one of its names is.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import Any

WEB = "dash"


class _Later:
    """A name of the web framework, looked up when it is used."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        return getattr(getattr(importlib.import_module(WEB), self._name), attribute)

    def __call__(self, *args: Any, **named: Any) -> Any:
        return getattr(importlib.import_module(WEB), self._name)(*args, **named)


class _Absent(ModuleType):
    """Stands for the web framework while Open3D is imported."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return _Later(name)


def open3d() -> Any:
    """The library. Raises ``ImportError`` as importing it does."""
    loaded = sys.modules.get("open3d")
    if loaded is not None and hasattr(loaded, "pipelines"):  # as after the import, not within it
        return loaded
    if "open3d" in sys.modules or WEB in sys.modules:
        return importlib.import_module("open3d")
    sys.modules[WEB] = _Absent(WEB)
    try:
        return importlib.import_module("open3d")
    finally:
        del sys.modules[WEB]
