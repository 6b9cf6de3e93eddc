"""Compiled kernels: numba's, kept on disk where old machine code is never taken for new."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

USE = b"from rbtm_bench.core.kernels import "
"""How a module that has kernels says so."""

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """``numba.njit`` with a cache on disk, for functions of arrays and numbers.

    numba looks only at the file that a kernel stands in, so an edit of a kernel that it calls
    would go unnoticed; our cache has a folder for every state of the files with kernels. It lies in
    NUMBA_CACHE_DIR, or XDG_CACHE_HOME or ~/.cache; where nothing can be written there, numba finds
    a place.
    """
    with _our_cache():
        compiled: Any = numba.njit(cache=True)(function)
    return cast(F, compiled)


def reordering_kernel(function: F) -> F:
    """A ``kernel`` whose sums may be added in any order, so that a processor adds several at once:
    the same order every time on one processor, whatever lies where in memory."""
    with _our_cache():
        compiled: Any = numba.njit(cache=True, fastmath={"reassoc", "contract", "nsz"})(function)
    return cast(F, compiled)


def broadcasting(layout: str, signature: str) -> Callable[[Callable[..., None]], Any]:
    """``numba.guvectorize`` with the same cache: a function that fills its last argument becomes
    one that returns it, for arrays whose leading axes broadcast."""

    def compiled(function: Callable[..., None]) -> Any:
        make: Any = numba.guvectorize
        with _our_cache():
            return make([signature], layout, cache=True)(function)

    return compiled


@contextmanager
def _our_cache() -> Iterator[None]:
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
