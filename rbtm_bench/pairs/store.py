"""Registrations already computed, shared by every run and process of a sweep.

Keys are exact (no rounding) and values come back bit for bit. A damaged or foreign file is set
aside and never trusted, and no trouble with the store stops a run: at worst it computes again.
``docs/pairstore.md`` says what holds on which file system, sizes and times.
"""

from __future__ import annotations

import io
import os
import sqlite3
import struct
import time
import warnings
import weakref
from collections.abc import Callable
from contextlib import AbstractContextManager, closing, nullcontext, suppress
from pathlib import Path
from types import TracebackType
from typing import IO, Literal, Self

from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.types import RegistrationResult
from rbtm_bench.pairs import files
from rbtm_bench.pairs.codec import checked, context, pack, pair_key, unpack
from rbtm_bench.pairs.files import (
    NAME,
    TROUBLE,
    How,
    StoreFile,
    insert,
    is_damage,
    open_store,
)

__all__ = ["PairStore", "context", "merge", "pair_key"]

_RESCAN = 10.0  # s between looks for files that other workers have sealed
_MOST_FILES = 256  # kept open
_MOST_DAMAGED = 3  # stores set aside by one process before it gives up


class PairStore:
    """The store as one process sees it; it belongs to the thread that made it.

    ``shared``: one file in ``folder``, for the processes of one machine. ``per_worker``: a file a
    process, for file systems that cannot lock; it also reads what others have closed and what
    ``merge`` has put together. ``put`` keeps up to ``batch`` pairs, up to about ``seconds`` s,
    before they are written. No trouble with files raises: ``notes`` (and a warning) tells it.
    While ``held`` nothing is written but by ``flush``: until then it can be dropped.
    """

    held = False
    _how: How = "shared"

    def __init__(
        self,
        folder: Path,
        mode: Literal["shared", "per_worker"] = "shared",
        batch: int = 256,
        seconds: float = 2.0,
    ) -> None:
        self.folder, self.mode, self.batch, self.seconds = Path(folder), mode, batch, seconds
        self.notes: list[str] = []
        self._state: Literal["parked", "open", "off", "closed"] = "parked"
        self._pending: dict[bytes, bytes] = {}
        self._due = 0.0  # when the oldest pending pair must be written
        self._files: list[StoreFile] = []  # where to look
        self._own: StoreFile | None = None  # the one of them to write to
        self._own_path: Path | None = None  # per_worker, from the first write on
        self._rescan = 0.0
        self._damaged = 0
        self._pid = os.getpid()
        _stores.add(self)
        self._ready()

    def get(self, key: bytes) -> RegistrationResult | BackendError | None:
        """The outcome of a pair that any process has stored; None if it is not known."""
        if not self._ready():
            return None
        if self._pending:
            if (blob := self._pending.get(key)) is not None:
                return unpack(key, blob)
            if time.monotonic() >= self._due and not self.held:
                self.flush()
        for file in self._files:
            try:
                row = file.db.execute("SELECT value FROM pairs WHERE key = ?", (key,)).fetchone()
                if row is not None:
                    return unpack(key, row[0])
            except TROUBLE as error:
                self._failed(error, file)
                break
        return None

    def put(self, key: bytes, outcome: RegistrationResult | BackendError) -> None:
        """Keep an outcome, unless the pair has one.

        Not kept: what would not come back as it is (with a note), and failures that are the
        machine's (a ``BackendError`` caused by a lack of memory or by a file).
        """
        if isinstance(getattr(outcome, "__cause__", None), MemoryError | OSError):
            return
        if not self._ready():
            return
        try:
            blob = pack(key, outcome)
        except (TypeError, struct.error) as error:
            self._note(f"a result is not kept: {error}")
            return
        if not self._pending:
            self._due = time.monotonic() + self.seconds
        self._pending.setdefault(key, blob)
        full = len(self._pending) >= self.batch or time.monotonic() >= self._due
        if full and not self.held:
            self.flush()

    def drop(self) -> None:
        """Forget what has been put and not been written."""
        self._pending.clear()

    def flush(self) -> None:
        """Write what ``put`` has kept back, in one transaction."""
        self._mind_forks()
        while self._pending and self._ready():
            try:
                insert(self._writable().db, self._pending.items())
                self._pending.clear()
            except TROUBLE as error:
                self._failed(error, self._own)
        if self.mode == "per_worker" and self._state == "open":
            self._guarded(self._find_sealed)

    def close(self) -> None:
        """Flush, and leave the files as the next process likes to find them."""
        if self._state == "closed":
            return
        self.flush()
        if self._state != "off":
            self._guarded(self._leave)
        self._close_files()
        self._state = "closed"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    # --- opening and closing

    def _ready(self) -> bool:
        """Whether the store can be used; opens it at first use and after a fork."""
        if self._pid != os.getpid():
            self._mind_forks()
        if self._state == "parked":
            self._guarded(self._open)
        return self._state == "open"

    def _open(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        if self.mode == "shared":
            with self._lock() as lock:
                self._own = self._open_shared(lock.read())
        elif self._own_path is not None:
            self._own = open_store(self._own_path, "alone")
        self._files = [self._own] if self._own else []
        if self.mode == "per_worker":
            self._rescan = 0.0
            self._find_sealed()
        self._state = "open"

    def _open_shared(self, stamp: str) -> StoreFile:
        path = self.folder / NAME
        if path.exists():
            try:
                files.check_shared(path, stamp, self._how)
                return open_store(path, self._how)
            except TROUBLE as error:
                if not is_damage(error, opening=True):
                    raise
                self._set_aside(path, error)
        files.create(path)
        return open_store(path, self._how)

    def _find_sealed(self) -> None:
        """Open, every few seconds, what other workers have sealed and what was merged."""
        if time.monotonic() < self._rescan:
            return
        self._rescan = time.monotonic() + _RESCAN
        known = {file.path for file in self._files}
        for path in [self.folder / NAME, *files.sealed_files(self.folder)]:
            if path in known or len(self._files) >= _MOST_FILES or not files.is_quiet(path):
                continue
            try:
                self._files.append(open_store(path, "sealed"))
            except TROUBLE as error:  # it may also be gone by now: merged
                if is_damage(error, opening=True):
                    self._set_aside(path, error)

    def _writable(self) -> StoreFile:
        """The file to write to, made or opened anew where need be."""
        own = self._own
        if own is not None and files.inode(own.path) != own.inode:
            self._close_files()  # another process has set it aside, or somebody deleted it
            self._own_path = None
            self._open()
        if self._own is None:
            self._own_path = files.new_worker_path(self.folder)
            files.create(self._own_path)
            self._own = open_store(self._own_path, "alone")
            self._files.insert(0, self._own)
        return self._own

    def _leave(self) -> None:
        """Close cleanly: mark the shared store as whole, seal one's own."""
        if self.mode == "shared" and self._own is not None:
            with self._lock() as lock:
                self._close_files()
                if stamp := files.stamp(self.folder / NAME):
                    lock.truncate(0)
                    lock.write(stamp)
        elif self._own_path is not None:
            self._close_files()
            os.rename(self._own_path, self._own_path.with_suffix(""))

    def _close_files(self) -> None:
        for file in self._files:
            with suppress(sqlite3.Error):
                file.db.close()
        self._own, self._files = None, []

    def _lock(self) -> AbstractContextManager[IO[str]]:
        return files.locked(self.folder)

    # --- forks

    def _park(self) -> None:
        """Before a fork: close the files until their next use."""
        if self._pid != os.getpid():
            return
        with suppress(sqlite3.Error):  # they are another thread's
            for file in self._files:
                file.db.close()
            self._own, self._files = None, []
            self._state = "parked" if self._state == "open" else self._state

    def _mind_forks(self) -> None:
        """In a forked process: leave the parent its pairs and its file."""
        if self._pid == os.getpid():
            return
        self._pid, self._own_path = os.getpid(), None
        self._pending.clear()
        if self._files:
            # SQLite believes that it holds the parent's locks, also for a file opened anew
            _inherited.extend(self._files)
            self._own, self._files = None, []
            self._give_up("another thread had the store open when this process was forked")

    # --- trouble

    def _failed(self, error: BaseException, file: StoreFile | None) -> None:
        """After an error in the middle of the work: set a damaged file aside, or give up."""
        if file is not None and file is not self._own:  # another worker's
            self._files.remove(file)
            file.db.close()
            if is_damage(error):
                self._guarded(self._set_aside, file.path, error)
            else:
                self._note(f"{file.path} is not read any more: {error}")
            return
        self._damaged += 1
        if file is None or not is_damage(error) or self._damaged > _MOST_DAMAGED:
            self._give_up(error)
        else:
            self._guarded(self._start_anew, file, error)

    def _start_anew(self, file: StoreFile, why: BaseException) -> None:
        if self.mode == "shared":
            with self._lock():
                # still open: SQLite does not touch a file that was moved under it
                if files.inode(file.path) == file.inode:
                    self._set_aside(file.path, why)
            self._close_files()
            self._open()
        else:
            self._set_aside(file.path, why)
            self._files.remove(file)
            file.db.close()
            self._own = self._own_path = None

    def _set_aside(self, path: Path, why: object) -> None:
        aside = files.set_aside(path)
        self._note(f"{path} is not to be trusted ({why}): set aside as {aside.name}")

    def _guarded(self, action: Callable[..., object], *arguments: object) -> None:
        try:
            action(*arguments)
        except TROUBLE as error:
            self._give_up(error)

    def _give_up(self, why: object) -> None:
        self._close_files()
        self._pending.clear()
        self._state = "off"
        self._note(f"{self.folder}: pairs are neither looked up nor kept from now on: {why}")

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)
            warnings.warn(text, RuntimeWarning, stacklevel=3)

    # --- merging

    def _fold(self, path: Path) -> bool:
        """Copy a worker's file, once all of it has been checked. False if that cannot be done."""
        how: How = "sealed" if path.suffix == ".sqlite" else "alone"
        try:
            with closing(open_store(path, how).db) as db:
                files.check_pages(db)
                for key, value in db.execute("SELECT key, value FROM pairs"):
                    checked(key, value)
                for key, value in db.execute("SELECT key, value FROM pairs"):
                    self._pending[key] = value
                    if len(self._pending) >= self.batch:
                        self.flush()
        except TROUBLE as error:
            if is_damage(error, opening=True):
                self._guarded(self._set_aside, path, error)
            else:
                self._note(f"{path} is left as it is: {error}")
            return False
        self.flush()
        return self._ready()

    def _count(self) -> int:
        try:
            if self._ready() and self._own is not None:
                return int(self._own.db.execute("SELECT count(*) FROM pairs").fetchone()[0])
        except TROUBLE as error:
            self._give_up(error)
        return 0


class _AloneStore(PairStore):
    """The shared store where nothing can be locked: for one process at a time."""

    _how: How = "alone"

    def _lock(self) -> AbstractContextManager[IO[str]]:
        return nullcontext(io.StringIO())


def merge(folder: Path) -> int:
    """Fold the files of ``per_worker`` stores into the shared one; how many pairs that has now.

    To be called when no worker runs any more, by one process. Sealed files and those of killed
    workers are checked, folded in and deleted; files of processes that are alive on this machine
    stay. Trouble becomes warnings, and what could not be folded in stays for the next time;
    0 if the store itself cannot be written.
    """
    folder = Path(folder)
    kind = PairStore if files.can_lock(folder) else _AloneStore
    with kind(folder, batch=4096) as store:
        paths = [*files.sealed_files(folder), *files.killed_files(folder)]
        folded = [path for path in paths if store._ready() and store._fold(path)]
        count = store._count()
    for path in folded:
        files.remove(path)
    files.clear_partial(folder, "pairs-")
    return count


_stores: weakref.WeakSet[PairStore] = weakref.WeakSet()
_inherited: list[StoreFile] = []  # of the parent, never to be closed by a child


def _park_all() -> None:
    """SQLite's locks do not survive a fork, and it does not notice: nothing may be open then."""
    for store in list(_stores):
        store._park()


os.register_at_fork(before=_park_all)
