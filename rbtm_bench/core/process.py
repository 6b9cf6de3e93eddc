"""How a process of ours begins and ends: importing libraries, and taking them apart again at the
end, takes longer than a small run does."""

from __future__ import annotations

import atexit
import contextlib
import gc
import os
import sys
from typing import NoReturn

_code: int | None = None
"""The exit code of a process that ends at once."""
_has_strangers = False


def begin() -> None:
    """Import without looking for garbage, until ``settle``: libraries leave none, and every look is
    one through all of their objects."""
    gc.disable()


def settle() -> None:
    """Look for garbage again, but not among what has been imported since ``begin``."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()


def has_strangers() -> None:
    """Say that plug-ins which are not ours are at home in this process: a file that one of them
    has left open is written when it is taken apart."""
    global _has_strangers
    _has_strangers = True


def end(code: int) -> NoReturn:
    """End the process with this exit code: threads are waited for and exit functions called, as
    ever, but hundreds of thousands of objects not taken apart one by one, unless strangers' are
    among them."""
    global _code
    if _has_strangers:
        gc.unfreeze()
    else:
        _code = code
    sys.exit(code)


def _end_at_once() -> None:
    if _code is not None:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError, AttributeError):  # closed, or none
                stream.flush()
        os._exit(_code)


atexit.register(_end_at_once)  # before others register theirs: the first one is called last
