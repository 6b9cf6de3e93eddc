"""What a foreign plug-in leaves behind: processes that outlive their worker, and a worker that is
no longer what it was."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import warnings
from pathlib import Path
from typing import Any

import numpy as np

MARK = "RBTM_BENCH_WORKER"
"""Stands in the environment of a worker, and so in that of whatever it starts."""
OURS = ("rbtm_bench", "numpy", "scipy")
"""Packages whose functions, where they are others than before, make a worker unfit."""
FILES = 50
"""Open files that a run may leave, as libraries do, before its worker is unfit."""
ROUNDS = 20


def state() -> dict[str, Any]:
    """What a run finds in its process, as far as later runs would notice a change."""
    found: dict[str, Any] = {
        "files": sum(1 for _ in Path("/proc/self/fd").glob("*")),
        "threads": threading.active_count(),
        "path": list(sys.path),
        "signals": [signal.getsignal(number) for number in signal.valid_signals()],
        "mask": signal.pthread_sigmask(signal.SIG_BLOCK, ()),
        "errors": np.geterr(),
        "random": hash(np.random.get_state()[1].tobytes()),  # type: ignore[index]
        "warnings": any(one[0] == "error" for one in warnings.filters),
        "streams": (id(sys.stdout), id(sys.stderr)),
    }
    found |= {f"environment {name}": value for name, value in os.environ.items()}
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] in OURS:
            fixed = [(k, v) for k, v in vars(module).items() if callable(v) or k.isupper()]
            found |= {f"{name}.{key}": id(value) for key, value in fixed}
    return found


def differs(before: dict[str, Any]) -> bool:
    """Whether anything that was there is another now. (What was added does no harm: imports do.)"""
    now = state()
    files, more = before.pop("files"), now.pop("files")
    return more > files + FILES or any(now.get(k) != value for k, value in before.items())


def end_marked(word: str) -> None:
    """Kill the processes that a worker with this mark has started, however they were detached."""
    mark, left = f"{MARK}={word}".encode(), True
    for _ in range(ROUNDS):
        if not left:
            return
        left = False
        for path in Path("/proc").glob("[0-9]*/environ"):
            with contextlib.suppress(OSError):  # gone, or another user's
                if mark in path.read_bytes().split(b"\0"):
                    os.kill(int(path.parent.name), signal.SIGKILL)
                    left = True


def descendants(pid: int) -> list[int]:
    """The numbers of the processes below one, those of none that is there: []."""
    found: list[int] = []
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            for child in map(int, path.read_text().split()):
                found += [child, *descendants(child)]
    return found


def resident_mb(pid: int) -> float:
    """What a process and its descendants have resident, in MB (10^6 bytes). Pages that several
    share count for each; a process that has just ended counts as nothing."""
    pages = 0
    for one in (pid, *descendants(pid)):
        with contextlib.suppress(OSError, IndexError):
            pages += int(Path("/proc", str(one), "statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") * 1e-6
