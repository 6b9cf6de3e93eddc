"""rbtm_bench: compare registration backends and model-scan selection strategies."""

import importlib
import importlib.machinery
import sys
import warnings
from collections.abc import Sequence
from types import ModuleType

__version__ = "0.1.0"

MOVED = {
    f"rbtm_bench.{name}": f"rbtm_bench.core.{name}"
    for name in ("errors", "files", "geometry", "kernels", "trajectory", "types", "uncertainty")
}
"""Modules that plug-ins written for version 0.1 import under their old names."""


class _Moved:
    """Gives the module under its new name to whoever imports it under its old one: a finder and a
    loader, without ``importlib.abc``, which takes as long to import as all of ``--help``."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if fullname not in MOVED:
            return None
        return importlib.machinery.ModuleSpec(fullname, self)  # type: ignore[arg-type]

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        new = MOVED[spec.name]
        warnings.warn(f"{spec.name} is now {new}", FutureWarning, stacklevel=2)
        module = importlib.import_module(new)
        self._own = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """It was executed under its new name, and keeps that."""
        module.__spec__ = self._own


sys.meta_path.append(_Moved())
