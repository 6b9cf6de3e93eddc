"""Runs in a child process that its parent supervises.

A backend may crash the process that it runs in, or never return. So every run happens in a
long-lived child (its imports and caches stay warm from one run to the next) whose death or time
limit costs one run: that becomes a failed row, and the next run gets a new child. The parent may
be the command line, a thread of it, a joblib or ray worker, or a submitit job.

Parent and child talk over a socket of their own, so that whatever a library prints cannot get in
between. The child dies with its parent, also with one that is killed by signal 9.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import pickle
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from rbtm_bench.core.errors import RunError
from rbtm_bench.engine import kept, sweep_folder, traces
from rbtm_bench.engine.channel import Channel, GarbageError

if TYPE_CHECKING:
    from rbtm_bench.runs.settings import Settings

Progress = Callable[[int, int], None]
"""Called with scans done and scans in all."""

POLL_S = 0.5
"""How often a waiting parent looks whether its child still lives."""
MEMORY_POLL_S = 0.1
"""How often it looks at a child's memory, if that has a limit."""
START_S = 120.0
"""A child that is not ready by then counts as broken."""
HANG_UP_S = 2.0
"""How long after the end of its channel a child may take to end."""
CLOSE_S = 10.0
"""What a child gets to end by itself when its work is over."""

BOOT = (
    "import json, sys; sys.path[:], *words = json.loads(sys.argv.pop()); "
    "from rbtm_bench.engine.child import serve; serve(*words)"
)
"""The child's program: the parent's module path first, so that both see the same modules."""


class ChildError(RunError):
    """The child died before it answered. ``trace`` says where it was, if it could still tell."""

    trace = ""


class LimitError(RunError):
    """The child took more than it may: of time, or of memory."""


class StoppedError(RunError):
    """The supervisor has to stop; its child was killed."""


@dataclass(eq=False)
class Child:
    """A running child: its process, our end of the socket, the end of a pipe whose closing
    kills it, and the file in which it describes a crash. ``pin``: on one core for life. ``serves``:
    the foreign packages of its runs; what they change in it they change for themselves alone."""

    process: subprocess.Popen[bytes]
    channel: Channel
    lifeline: IO[bytes]
    crash: IO[bytes]
    pin: bool
    cwd: Path
    serves: frozenset[str] = frozenset()
    mark: str = ""
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @classmethod
    def start(cls, pin: bool, cwd: Path, serves: frozenset[str] = frozenset()) -> Child:
        """Start a child and wait until it is ready. Raises ``ChildError`` if that fails."""
        ours, theirs = socket.socketpair()
        mark = os.urandom(8).hex()
        channel = Channel(ours, bytes.fromhex(mark), plain=bool(serves))
        heard, lifeline = os.pipe()
        crash = _scratch_file()
        fds = (theirs.fileno(), heard, crash.fileno())
        words = json.dumps([[str(place) for place in sys.path], *fds, pin, mark, bool(serves)])
        error_output = _error_output()  # standard output is the parent's alone: for tables
        try:
            process = subprocess.Popen(
                [sys.executable, "-P", "-c", BOOT, words],
                stdin=subprocess.DEVNULL,
                stdout=error_output,
                stderr=error_output,
                pass_fds=fds,
                cwd=cwd,
                env={**os.environ, traces.MARK: mark},
                process_group=0,  # Ctrl-C is for the parent; and a kill takes what it started too
            )
        finally:
            theirs.close()
            os.close(heard)
        child = cls(process, channel, os.fdopen(lifeline, "wb"), crash, pin, cwd, serves, mark)
        try:
            child.receive(time.monotonic() + START_S)
        except BaseException as error:
            child.end()
            if isinstance(error, TimeoutError):
                raise ChildError(f"no process was ready after {START_S:g} s") from None
            raise
        return child

    def receive(self, deadline: float | None = None, memory_limit: float | None = None) -> Any:
        """The child's next message. Raises ``TimeoutError``, ``LimitError`` where it has more than
        ``memory_limit`` MB resident, or ``ChildError``."""
        while True:
            left = POLL_S if memory_limit is None else MEMORY_POLL_S
            left = left if deadline is None else min(left, deadline - time.monotonic())
            if memory_limit is not None:
                self._refuse_beyond(memory_limit)
            try:
                with contextlib.suppress(TimeoutError):
                    return self.channel.receive(max(left, 0.0))
                if self._exited():
                    return self.channel.receive(0.0)
            except GarbageError as error:
                self.kill()
                raise ChildError(str(error)) from None
            except (EOFError, OSError):  # a TimeoutError, too: it said nothing before it died
                raise self._post_mortem() from None
            self._wake()
            if deadline is not None and time.monotonic() >= deadline:
                raise TimeoutError

    def _refuse_beyond(self, memory_limit: float) -> None:
        used = traces.resident_mb(self.process.pid)
        if used > memory_limit:
            raise LimitError(f"more than memory_limit={memory_limit:g} MB ({used:.0f} MB)")

    def _wake(self) -> None:
        """Let a process go on that has been stopped: nobody else would."""
        with contextlib.suppress(ChildProcessError, ProcessLookupError):
            if os.waitid(os.P_PID, self.process.pid, os.WSTOPPED | os.WNOHANG) is not None:
                os.killpg(self.process.pid, signal.SIGCONT)

    def _exited(self) -> bool:
        """True if the process has ended. It stays a zombie: nobody else gets its number."""
        if self.process.returncode is not None:
            return True
        try:
            how = os.WEXITED | os.WNOHANG | os.WNOWAIT
            return os.waitid(os.P_PID, self.process.pid, how) is not None
        except ChildProcessError:
            return True  # another thread has just collected it

    def _post_mortem(self) -> ChildError:
        """What the child died of; the socket may close a little before the process ends."""
        patience = time.monotonic() + HANG_UP_S
        while not (exited := self._exited()) and time.monotonic() < patience:
            time.sleep(0.005)
        self.kill()
        why = f"the process died: {cause_of_death(self.process.returncode)}"
        error = ChildError(why if exited else "it closed the channel to its parent")
        self.crash.seek(0)
        error.trace = self.crash.read().decode(errors="replace").strip()
        return error

    def kill(self) -> None:
        """End the process, and those that it has started, at once; from any thread."""
        with self._lock:
            if self.process.returncode is None:
                for pid in (-self.process.pid, *traces.descendants(self.process.pid)):
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGKILL)
                self.process.wait()
            if self.serves:
                traces.end_marked(self.mark)

    def end(self, patience: float = 0.0) -> None:
        """Let the process end by itself if it does so within ``patience`` s; kill it if not."""
        self.channel.close()
        if patience:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(patience)
        self.kill()
        self.lifeline.close()
        self.crash.close()


class Supervisor:
    """Owns one child at a time. For one thread, but ``kill`` may come from any other."""

    def __init__(self, cwd: Path | None = None, argv: Sequence[str] | None = None) -> None:
        """``cwd``: the folder that the child works in; ``argv``: the command that its runs note
        down. None: those of this process."""
        self.cwd, self.argv = cwd, argv
        self._child: Child | None = None
        self._kept: kept.Kept | None = None
        self._stopped = False

    @property
    def pid(self) -> int | None:
        """The child's process number, None if there is no child."""
        return self._child.process.pid if self._child else None

    @property
    def serves(self) -> frozenset[str] | None:
        """The foreign packages that the child has run, None if there is no child."""
        return self._child.serves if self._child else None

    def run(
        self,
        name: str,
        settings: Settings,
        out: Path,
        progress: Progress | None = None,
    ) -> dict[str, Any]:
        """One run in the child; returns its ``run.json`` whatever happens to the child.

        The settings' ``time_limit``, in s, counts from when the child begins; ``memory_limit``, in
        MB, is for the child and the processes that it has started. Raises ``StoppedError`` when
        ``kill`` is called: the run then stays "started".
        """
        from rbtm_bench.engine.one_run import ended_by, run_one, undone
        from rbtm_bench.runs.plugins import foreign_modules

        pin = bool(settings.config.get("pin", True))
        serves = foreign_modules(settings.config)
        self._kept = kept.of(out.absolute().parent, make=bool(serves))
        if self._kept is not None and serves:
            self._kept.keep_all()
        try:
            job = (run_one, (name, settings, out.absolute()))
            limits = (settings.config.get("time_limit"), settings.config.get("memory_limit"))
            _, record = self._ask(job, pin, limits, progress, serves)
            record = dict(record)
        except LimitError as error:
            record = ended_by(error, settings, out)
        except ChildError as error:
            record = ended_by(error, settings, out, error.trace)
        if self._kept is None:
            return record
        if serves and (changed := self._kept.put_back()):
            record = undone(changed, settings, out)
        elif serves and sweep_folder.status(out) == "started":  # no room to say how it ended
            record = ended_by(RunError(str(record["reason"])), settings, out)
        self._kept.keep(out.absolute())
        return record

    def call(
        self,
        function: Callable[..., Any],
        *args: Any,
        pin: bool = True,
        serves: frozenset[str] = frozenset(),
    ) -> Any:
        """``function(*args)`` in the child: returns what it returns, raises what it raises.
        ``serves`` are the foreign packages that it looks into."""
        return self._ask((function, args), pin, serves=serves)

    def _ask(
        self,
        job: tuple[Callable[..., Any], tuple[Any, ...]],
        pin: bool,
        limits: tuple[float | None, float | None] = (None, None),
        progress: Progress | None = None,
        serves: frozenset[str] = frozenset(),
    ) -> Any:
        """Hand over a job and wait for the answer, with ``limits`` in s and MB. Without an answer
        the child is gone."""
        time_limit, memory_limit = limits
        message = (*job, list(self.argv or sys.argv), progress is not None)
        try:
            child = self._begin(pickle.dumps(message), pin, serves)
            deadline = None if time_limit is None else time.monotonic() + time_limit
            while (reply := child.receive(deadline, memory_limit))[0] == "progress":
                if progress is not None:
                    progress(*reply[1])
        except TimeoutError:
            self._drop()
            raise LimitError(f"time limit of {time_limit:g} s") from None
        except BaseException as error:
            self._drop()
            if self._stopped and isinstance(error, ChildError):
                raise StoppedError("stopped") from None
            raise
        kind, answer = reply
        if kind == "raised":
            raise answer
        return answer

    def _begin(self, message: bytes, pin: bool, serves: frozenset[str]) -> Child:
        """A child that has begun with the job; one that died while it was idle is replaced."""
        for first in (True, False):
            child = self._living(pin, serves)
            try:
                child.channel.send_bytes(message)
                child.receive()
                return child
            except (ChildError, OSError) as error:
                self._drop()
                if not first or self._stopped:
                    raise ChildError(str(error)) from error
        raise AssertionError("two tries end in a return or an error")

    def _living(self, pin: bool, serves: frozenset[str]) -> Child:
        """The child; a new one if there is none, or none that is pinned and placed like this and
        serves these foreign packages: it never goes back to others, or to none."""
        cwd = self.cwd or Path.cwd()
        wanted = (pin, cwd, serves)
        child = self._child
        if child is not None and (child.pin, child.cwd, child.serves) != wanted:
            self.close()
        if self._child is None:
            self._child = Child.start(*wanted)
        if self._stopped:
            raise StoppedError("stopped")
        return self._child

    def _drop(self) -> None:
        child, self._child = self._child, None
        if child is not None:
            child.kill()
            child.end()

    def kill(self) -> None:
        """End the child at once and start no other; from any thread."""
        self._stopped = True
        if (child := self._child) is not None:
            child.kill()

    def close(self) -> None:
        """End the child, which has nothing to do but may have something to write."""
        child, self._child = self._child, None
        if child is not None:
            child.end(CLOSE_S)

    def __enter__(self) -> Supervisor:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


_own: dict[int, Supervisor] = {}


def own_supervisor(cwd: Path | None = None, argv: Sequence[str] | None = None) -> Supervisor:
    """This process's own supervisor, made when first asked for and closed at exit."""
    pid = os.getpid()  # a forked process does not own its parent's
    if pid not in _own:
        _own[pid] = Supervisor()
        atexit.register(_own[pid].close)
    _own[pid].cwd, _own[pid].argv = cwd, argv
    return _own[pid]


def cause_of_death(code: int) -> str:
    """A return code in words: "signal 11 (SIGSEGV)", "exit code 3"."""
    if code >= 0:
        return f"exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = "unknown"
    return f"signal {-code} ({name}{'; perhaps out of memory' if name == 'SIGKILL' else ''})"


def _scratch_file() -> IO[bytes]:
    """A file without a name: in memory where the system can, so that a full disk is no matter."""
    if hasattr(os, "memfd_create"):
        return os.fdopen(os.memfd_create("crash"), "r+b")
    return tempfile.TemporaryFile()


def _error_output() -> int:
    """Where a child may print: our standard error, unless that is closed."""
    try:
        os.fstat(2)
    except OSError:
        return subprocess.DEVNULL
    return 2
