"""One core a run: the only thing that makes Open3D repeat its bits from call to call.

Open3D's thread pools are sized when the library is first used, so a process must be pinned
before any backend library is imported. Thread variables such as OMP_NUM_THREADS do not suffice.
"""

from __future__ import annotations

import fcntl
import os
import tempfile
from pathlib import Path
from typing import IO

SEATS = 32
"""Processes that a core is shared by before nobody counts them any more."""

_held: list[IO[str]] = []
_core: int | None = None


def pin_to_free_core() -> int | None:
    """Pin this process to one core that no other process of ours has claimed; return its number.

    A claim is a lock on a small file, held until the process ends, so that workers and separate
    sweeps of one user spread over the machine. With more processes than cores each core is claimed
    a second time, and so on.
    Returns the same core when called again, and None where the platform cannot pin.
    """
    global _core
    if _core is not None or not hasattr(os, "sched_setaffinity"):
        return _core
    cores = sorted(os.sched_getaffinity(0))
    seats = ((core, seat) for seat in range(SEATS) for core in cores)
    _core = next(
        (core for core, seat in seats if _claim(core, seat)), cores[os.getpid() % len(cores)]
    )
    os.sched_setaffinity(0, {_core})
    return _core


def _claim(core: int, seat: int) -> bool:
    """Try to lock the file of one of a core's seats."""
    try:
        folder = Path(tempfile.gettempdir()) / f"rbtm_bench-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        lock = open(folder / f"core-{core}-{seat}.lock", "a")  # noqa: SIM115 (held until exit)
    except OSError:
        return False
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        lock.close()
        return False
    _held.append(lock)
    return True
