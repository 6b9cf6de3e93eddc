"""Somebody else's backend that misbehaves at its 4th scan, in a way of one's choice."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from rbtm_bench.backends.base import Alignment, Backend, Prepared
from rbtm_bench.core.types import Array

GOBBLE = 400_000_000
"""Bytes that a greedy one takes."""
CONFIGS = Path(__file__).parent / "moody_configs"


class Moody(Backend):
    """Like backend=none, but for its mood; ``unless`` is a file that keeps it quiet."""

    def __init__(self, how: str = "none", unless: str | None = None) -> None:
        super().__init__()
        self.how, self.unless, self.calls = how, unless, 0

    def build(self, points: Array, planar: bool) -> None:
        self.calls += 1
        if self.calls == 4 and not (self.unless and Path(self.unless).exists()):
            ill(self.how)
        if self.how == "slow":
            time.sleep(0.02)

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        return Alignment(T_target_source)


def gobble() -> None:
    """Take memory, bit by bit, and keep it."""
    kept = []
    for _ in range(10):
        kept.append(b"x" * (GOBBLE // 10))
        time.sleep(0.05)
    time.sleep(600)


def ill(how: str) -> None:
    """Raise, crash, hang or print."""
    moods: dict[str, Any] = {
        "raise": lambda: 1 / 0,
        "leave": lambda: sys.exit("licence expired"),
        "segfault": lambda: os.kill(os.getpid(), signal.SIGSEGV),
        "exit": lambda: os._exit(3),
        "hang": lambda: time.sleep(600),
        "hang_in_c": lambda: ctypes.PyDLL(None).sleep(600),  # holds the interpreter's lock
        "fork_and_hang": lambda: subprocess.run(["sleep", "617"]),
        "gobble": gobble,
        "gobble_elsewhere": lambda: subprocess.run(
            [sys.executable, "-c", f"import time; x = b'x' * {GOBBLE}; time.sleep(617)"],
            start_new_session=True,
        ),
        "print": lambda: os.system("echo noise; echo noise >&2"),
    }
    if how in moods:
        moods[how]()
