"""rbtm_bench: compare registration backends and model-scan selection strategies.

``import rbtm_bench as rb`` loads nothing but this file; what ``__all__`` names is imported when it
is first asked for (docs/python.md).
"""

import importlib
import importlib.machinery
import sys
import warnings
from collections.abc import Sequence
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rbtm_bench.api import compare, evaluate, load_runs, odometry, open_dataset, register, run
    from rbtm_bench.backends.base import Backend
    from rbtm_bench.check.base import Check
    from rbtm_bench.core.trajectory import Trajectory
    from rbtm_bench.core.types import Scan
    from rbtm_bench.datasets.base import Dataset
    from rbtm_bench.guess.base import Guess
    from rbtm_bench.selection.base import Selector
    from rbtm_bench.similarity.base import Similarity
    from rbtm_bench.target.base import Target

__version__ = "0.1.0"

__all__ = [
    "Backend",
    "Check",
    "Dataset",
    "Guess",
    "Scan",
    "Selector",
    "Similarity",
    "Target",
    "Trajectory",
    "compare",
    "evaluate",
    "load_runs",
    "odometry",
    "open_dataset",
    "register",
    "run",
]

HOMES = {
    "Scan": "core.types",
    "Trajectory": "core.trajectory",
    "Backend": "backends.base",
    "Selector": "selection.base",
    "Similarity": "similarity.base",
    "Target": "target.base",
    "Dataset": "datasets.base",
    "Guess": "guess.base",
    "Check": "check.base",
}
"""Where the classes of ``__all__`` live; its functions are ``api``'s."""


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    thing = getattr(importlib.import_module(f"{__name__}.{HOMES.get(name, 'api')}"), name)
    # the room odometry has bound its own name by now, and is called instead
    return globals().setdefault(name, thing)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


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
