"""The child's end of ``crew``: it does one job after the other until its parent hangs up."""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import importlib
import os
import pickle
import select
import signal
import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rbtm_bench.core import errors, process
from rbtm_bench.core.errors import RbtmBenchError, RunError
from rbtm_bench.engine.channel import Channel
from rbtm_bench.engine.traces import differs, state

PR_SET_CHILD_SUBREAPER = 36
"""prctl(2): children that lose their parent become this process's."""

Progress = Callable[[int, int], None]
"""Called with scans done and scans in all."""

MESSAGE = 10_000
"""Characters of an error that the parent is told."""
PROGRESS_S = 0.2
"""Least time between two messages of progress."""

NEEDED = ("rbtm_bench.engine.one_run", "pyarrow.parquet", "evo.core.metrics")
"""What every run needs, loaded before a time limit counts; a backend's library is not."""


def serve(channel_fd: int, lifeline: int, crash: int, pin: bool, word: str, foreign: bool) -> None:
    """The child: answer one job after the other until the parent hangs up."""
    import faulthandler

    process.begin()
    for fd in (channel_fd, lifeline, crash):
        os.set_inheritable(fd, False)  # what a backend starts must not keep them open
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _die_at_end_of(lifeline)
    faulthandler.enable(crash, all_threads=False)
    if pin:
        from rbtm_bench.runs.pinning import pin_to_free_core

        pin_to_free_core()
    for module in NEEDED:
        importlib.import_module(module)
    channel = Channel(socket.socket(fileno=channel_fd), bytes.fromhex(word))
    place, own = os.getcwd(), os.getpid()
    _adopt_orphans()
    channel.send("ready")
    while True:
        try:
            message = channel.receive_bytes()
        except (EOFError, OSError):
            _leave()
        channel.send("begun")
        os.chdir(place)  # wherever the last job went
        before = state() if foreign else {}
        answer = _answer(message, channel)
        _leave_if_forked(own)
        channel.send(answer)
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError, AttributeError):  # closed, or none
                stream.flush()
        if foreign and differs(before):
            _leave()


def _leave() -> None:
    """End at once, whatever a plug-in would still do: threads, exit functions. A process in which
    one has changed something is not used again; the parent starts another when it needs one."""
    from rbtm_bench.runs.workbench import close_own

    with contextlib.suppress(Exception):
        close_own()
    os._exit(0)


def _answer(message: bytes, channel: Channel) -> tuple[str, Any]:
    """Do a job: ("returned", value) or ("raised", exception)."""
    try:
        function, args, sys.argv[:], watched = pickle.loads(message)
        options = {"progress": _reporter(channel)} if watched else {}
        answer = ("returned", function(*args, **options))
        pickle.dumps(answer)
        return answer
    except RbtmBenchError as error:
        # a plug-in's own class may be one that cannot be read again
        ours = (kind for kind in type(error).__mro__ if kind.__module__ == errors.__name__)
        return "raised", next(ours)(errors.one_line(error, MESSAGE))
    except BaseException as error:
        return "raised", RunError(f"{type(error).__name__}: {errors.one_line(error)}")


def _reporter(channel: Channel) -> Progress:
    """Sends progress on, as often as an eye can follow."""
    sent, own = 0.0, os.getpid()

    def report(done: int, total: int) -> None:
        nonlocal sent
        _leave_if_forked(own)
        now = time.monotonic()
        if now - sent >= PROGRESS_S:
            sent = now
            channel.send(("progress", (done, total)))

    return report


def _leave_if_forked(own: int) -> None:
    """End a twin that a plug-in forked: the parent listens to one process."""
    if os.getpid() != own:
        os._exit(1)


def _adopt_orphans() -> None:
    """Have what a plug-in starts and detaches become a child of this process, not of init."""
    with contextlib.suppress(OSError, AttributeError):  # Linux alone has it
        ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def end_left_processes() -> int:
    """Kill the processes that this one's plug-ins have started and not waited for; how many."""
    left = 0
    while True:
        children = [
            int(pid)
            for path in Path("/proc/self/task").glob("*/children")
            for pid in path.read_text().split()
        ]
        if not children:
            return left
        for pid in children:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
            with contextlib.suppress(ChildProcessError):
                os.waitpid(pid, 0)
        left += len(children)


def _die_at_end_of(lifeline: int) -> None:
    """Have the kernel kill this process when the other end of a pipe closes.

    The signal's default action needs no Python, so it reaches a backend that hangs in C. (Linux's
    PR_SET_PDEATHSIG would come when the parent's thread ends, not its process.)
    """
    signal.signal(signal.SIGIO, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGIO})
    fcntl.fcntl(lifeline, fcntl.F_SETOWN, os.getpid())
    flags = fcntl.fcntl(lifeline, fcntl.F_GETFL)
    fcntl.fcntl(lifeline, fcntl.F_SETFL, flags | os.O_ASYNC)
    if select.select([lifeline], [], [], 0)[0]:  # it closed before anybody watched it
        os._exit(1)
