"""Compiled kernels: numba's, kept on disk where old machine code is never taken for new.

Nothing is compiled, or loaded, and numba not even imported, before a kernel is first called: who
only looks at a plug-in's class does without.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, cached_property, update_wrapper
from pathlib import Path
from typing import Any, TypeVar, cast

USE = b"from rbtm_bench.core.kernels import "
"""How a module that has kernels says so."""

F = TypeVar("F", bound=Callable[..., Any])


class Kernel:
    """A function that numba compiles when it is first called, by us or by another kernel."""

    def __init__(self, function: Callable[..., Any], make: Callable[..., Any]) -> None:
        update_wrapper(self, function)
        self._function, self._make = function, make

    def __call__(self, *args: Any) -> Any:
        return self.compiled(*args)

    @cached_property
    def compiled(self) -> Any:
        """What numba makes of it."""
        _teach_numba()
        with _our_cache():
            return self._make(self._function)


@cache
def _teach_numba() -> None:
    """Have numba take a ``Kernel`` that a kernel calls for what is compiled of it."""
    from numba.core.types import Dispatcher
    from numba.extending import typeof_impl

    @typeof_impl.register(Kernel)
    def of_kernel(one: Kernel, context: Any) -> Any:
        return Dispatcher(one.compiled)


def kernel(function: F) -> F:
    """``numba.njit`` with a cache on disk, for functions of arrays and numbers.

    numba looks only at the file that a kernel stands in, so an edit of a kernel that it calls
    would go unnoticed; our cache has a folder for every state of the files with kernels. It lies in
    NUMBA_CACHE_DIR, or XDG_CACHE_HOME or ~/.cache; where nothing can be written there, numba finds
    a place.
    """

    def make(function: Callable[..., Any]) -> Any:
        import numba

        return numba.njit(cache=True)(function)

    return cast(F, Kernel(function, make))


def reordering_kernel(function: F) -> F:
    """A ``kernel`` whose sums may be added in any order, so that a processor adds several at once:
    the same order every time on one processor, whatever lies where in memory."""

    def make(function: Callable[..., Any]) -> Any:
        import numba

        return numba.njit(cache=True, fastmath={"reassoc", "contract", "nsz"})(function)

    return cast(F, Kernel(function, make))


def broadcasting(layout: str, signature: str) -> Callable[[Callable[..., None]], Any]:
    """``numba.guvectorize`` with the same cache: a function that fills its last argument becomes
    one that returns it, for arrays whose leading axes broadcast."""

    def make(function: Callable[..., None]) -> Any:
        import numba

        guvectorize: Any = numba.guvectorize
        return guvectorize([signature], layout, cache=True)(function)

    def waiting(function: Callable[..., None]) -> Any:
        _waiting.append(Kernel(function, make))
        return _waiting[-1]

    return waiting


_waiting: list[Kernel] = []
"""Kernels whose one signature is known, not compiled yet."""


def make_ready() -> None:
    """Compile, or load from disk, those of the modules imported so far, on nobody's time."""
    while _waiting:
        _ = _waiting.pop().compiled


@contextmanager
def _our_cache() -> Iterator[None]:
    import numba

    settings: Any = numba.config
    before = settings.CACHE_DIR
    settings.CACHE_DIR = cache_folder() or before
    try:
        yield
    finally:
        settings.CACHE_DIR = before


@cache
def cache_folder() -> str:
    """The folder of this state of those files; empty if it cannot be made."""
    import numba

    settings: Any = numba.config
    root = settings.CACHE_DIR or os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    folder = Path(root).expanduser() / "rbtm_bench" / f"kernels-{digest()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # RuntimeError: nobody's home
        return ""
    return str(folder) if os.access(folder, os.W_OK) else ""


def digest(package: Path = Path(__file__).parents[1]) -> str:
    """Changes with any source file of the package that has kernels."""
    state = hashlib.blake2b(digest_size=6)
    for path in sorted(package.rglob("*.py")):
        source = path.read_bytes()
        if USE in source:
            state.update(f"{path.relative_to(package)} {len(source)}\n".encode() + source)
    return state.hexdigest()
