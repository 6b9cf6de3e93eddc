"""Registrations already computed, shared by every run and process of a sweep: one SQLite table.

Keys are exact and values come back bit for bit. No file is trusted, and no trouble with one stops
a run: at worst it computes again. ``docs/pairstore.md`` says what holds on which file system.
"""

from __future__ import annotations

import os
import platform
import re
import secrets
import sqlite3
import sys
import time
import weakref
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from typing import Literal, NamedTuple, Self

from rbtm_bench.pairs.codec import FORMAT, Outcome, is_intact, pack, unpack

_TABLE = "CREATE TABLE pairs (key BLOB PRIMARY KEY, value BLOB NOT NULL) WITHOUT ROWID"
_SHARED = "mode=rwc"  # for the processes of one machine: locks, and a log whose index they share
_PRIVATE = "mode=rwc&vfs=unix-none"  # for this process alone: no locks
_CLOSED = "mode=ro&immutable=1"  # for what nobody writes any more
_WAIT = 60.0  # s for other processes
_MOST_FILES = 100  # kept open
_MOST_DAMAGED = 3  # files set aside by one process before it gives up
_HOST = re.sub(r"[^A-Za-z0-9.]", "_", platform.node()) or "host"


class DamageError(Exception):
    """A file that is no store of this version. Never leaves this module."""


TROUBLE = (sqlite3.Error, OSError, MemoryError, UnicodeError, DamageError)


class PairStore:
    """The store as one process sees it: a file to write to, and those that others have closed.

    ``shared``: all write to one file in ``folder``, for the processes of one machine.
    ``per_worker``: a file a process, for file systems that cannot lock. Up to ``batch`` pairs are
    kept for up to about ``seconds`` s before they are written. No trouble with files raises: one
    printed line says it.
    """

    def __init__(
        self,
        folder: Path,
        mode: Literal["shared", "per_worker"] = "shared",
        batch: int = 256,
        seconds: float = 2.0,
    ) -> None:
        self._folder, self._batch, self._seconds = Path(folder), batch, seconds
        self._is_shared = mode == "shared"
        self._path = self._own_path()
        self._files: dict[Path, _File] = {}  # the one to write to first
        self._state: Literal["parked", "open", "off"] = "parked"
        self._pending: dict[bytes, bytes] = {}
        self._due = 0.0  # when the oldest pending pair must be written
        self._held = False
        self._damaged = 0
        self._said: set[str] = set()
        _stores.add(self)
        self._is_open()

    def get(self, key: bytes) -> Outcome | None:
        """The outcome of a pair that any process has stored; None if it is not known."""
        if key in self._pending:
            return unpack(key, self._pending[key])
        for path, file in self._files.items() if self._is_open() else ():
            try:
                row = file.db.execute("SELECT value FROM pairs WHERE key = ?", (key,)).fetchone()
            except TROUBLE as error:
                self._trouble(path, error)
                break
            if row is not None:
                if (outcome := unpack(key, row[0])) is not None:
                    return outcome
                self._say(f"a pair in {path} does not fit its checksum: such are computed again")
        return None

    def put(self, key: bytes, outcome: Outcome) -> None:
        """Keep an outcome, but for what would not come back as it is, and for failures that are
        the machine's (a ``BackendError`` caused by a lack of memory or by a file)."""
        if not isinstance(getattr(outcome, "__cause__", None), MemoryError | OSError):
            try:
                self._keep(key, pack(key, outcome))
            except TypeError as error:
                self._say(f"a registration is not kept: {error}")

    def hold(self, held: bool) -> None:
        """Whether to write nothing but by ``flush``: until then it can be dropped."""
        self._held = held

    def drop(self) -> None:
        """Forget what has been put and not been written."""
        self._pending.clear()

    def flush(self) -> None:
        """Write what ``put`` has kept back, and look for what others have closed."""
        self._write()
        if self._is_open():
            self._guarded(self._open_closed)

    def take(self, path: Path) -> bool:
        """Copy another file's pairs that fit their checksums, and whether that is done with it: a
        file that cannot be read to its end is set aside."""
        try:
            with closing(_opened(path, _PRIVATE).db) as db:
                for key, value in db.execute("SELECT key, value FROM pairs"):
                    if is_intact(key, value):
                        self._keep(key, value)
        except TROUBLE as error:
            self._guarded(self._refuse, path, _inode(path), error)
            return False
        self._write()
        return self._is_open()

    def close(self) -> None:
        """Flush, and leave the files as the next process likes to find them."""
        self._write()
        self._close_files()
        if self._state != "off" and not self._is_shared and _inode(self._path):
            self._guarded(os.rename, self._path, self._path.with_suffix(""))
        self._state = "off"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def park(self, forked: bool = False) -> None:
        """Close the files until their next use: SQLite's locks do not survive a fork. A ``forked``
        process leaves its parent the pairs and the file."""
        self._close_files()
        self._state = "off" if self._state == "off" else "parked"
        if forked:
            self._pending, self._path = {}, self._own_path()

    def _keep(self, key: bytes, blob: bytes) -> None:
        if not self._pending:
            self._due = time.monotonic() + self._seconds
        self._pending[key] = blob
        full = len(self._pending) >= self._batch or time.monotonic() >= self._due
        if full and not self._held:
            self._write()

    def _write(self) -> None:
        """Write all that is pending in one transaction; or forget it, where nothing can be."""
        while self._pending and self._is_open():
            own = self._files[self._path]
            if own.inode != _inode(self._path):
                self.park()  # deleted, or set aside by another process
                continue
            try:
                with own.db as db:
                    db.executemany("REPLACE INTO pairs VALUES (?, ?)", self._pending.items())
                self._pending.clear()
            except TROUBLE as error:
                self._trouble(self._path, error)
        self._pending.clear()

    def _own_path(self) -> Path:
        """The file to write to; a worker's loses its ``.open`` when it is closed."""
        name = f"pairs-{_HOST}-{os.getpid()}-{secrets.token_hex(4)}.sqlite.open"
        return self._folder / ("pairs.sqlite" if self._is_shared else name)

    def _is_open(self) -> bool:
        """Whether the store can be used; opens it at first use and after a fork."""
        if self._state == "parked":
            self._state = "open"
            self._guarded(self._open)
        return self._state == "open"

    def _open(self) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        how, inode = _SHARED if self._is_shared else _PRIVATE, _inode(self._path)
        try:
            self._files[self._path] = _opened(self._path, how)
        except TROUBLE as error:
            if not _is_damage(error):
                raise
            self._refuse(self._path, inode, error)
            self._files[self._path] = _opened(self._path, how)
        self._open_closed()

    def _open_closed(self) -> None:
        for path in [self._folder / "pairs.sqlite", *sorted(self._folder.glob("pairs-*.sqlite"))]:
            is_used = path in self._files or _beside(path, "-wal").exists() or not path.exists()
            if not is_used and len(self._files) < _MOST_FILES:
                inode = _inode(path)
                try:
                    self._files[path] = _opened(path, _CLOSED)
                except TROUBLE as error:
                    self._refuse(path, inode, error)

    def _close_files(self) -> None:
        for file in self._files.values():
            with suppress(sqlite3.Error):
                file.db.close()
        self._files = {}

    def _trouble(self, path: Path, error: BaseException) -> None:
        """After an error in the middle of the work: begin a damaged file anew, do without another
        worker's, or give up."""
        self._damaged += 1
        is_lost = path == self._path and not _is_damage(error)
        if is_lost or self._damaged > _MOST_DAMAGED:
            self._give_up(error)
            return
        # renamed while it is open: SQLite does not touch a file that was moved under it
        self._guarded(self._refuse, path, self._files[path].inode, error)
        self.park()

    def _refuse(self, path: Path, inode: int | None, why: BaseException) -> None:
        """Rename a damaged file, and what belongs to it, to the first free ``<name>.damaged-<n>``;
        but not what another process has put in its place."""
        if not _is_damage(why) or inode != _inode(path):
            self._say(f"{path} is not read: {why}")
            return
        n = 1
        while _beside(path, f".damaged-{n}").exists():
            n += 1
        aside = _beside(path, f".damaged-{n}")
        for ending in ("-wal", "-shm", "-journal", ""):
            with suppress(FileNotFoundError):
                os.rename(_beside(path, ending), _beside(aside, ending))
        self._say(f"{path} is not used ({why}): set aside as {aside.name}")

    def _guarded(self, action: Callable[..., object], *arguments: object) -> None:
        try:
            action(*arguments)
        except TROUBLE as error:
            self._give_up(error)

    def _give_up(self, why: BaseException) -> None:
        self._close_files()
        self._state = "off"
        other = " (pairs.store=per_worker needs no locks)" if self._is_shared else ""
        self._say(f"{self._folder}: pairs are neither read nor kept from now on: {why}{other}")

    def _say(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            print(f"rbtm-bench: {' '.join(text.split())}", file=sys.stderr)


def merge(folder: Path) -> None:
    """Fold the closed files of ``per_worker`` stores, and those of killed workers, into one.

    The files of processes that are alive on this machine stay, and so does what cannot be read or
    written.
    """
    killed = [path for path in folder.glob("pairs-*.sqlite.open") if not _is_alive(path)]
    paths = sorted([*folder.glob("pairs-*.sqlite"), *killed])
    if killed or len(paths) > 1:
        with PairStore(folder, "per_worker", batch=4096) as store:
            for path in paths:
                if path.exists() and store.take(path):
                    with suppress(OSError):
                        path.unlink()


class _File(NamedTuple):
    db: sqlite3.Connection
    inode: int | None


def _opened(path: Path, how: str) -> _File:
    """A store, made if there is none. Raises ``DamageError`` for a file that is something else."""
    end = time.monotonic() + _WAIT
    while True:
        db = sqlite3.connect(
            f"{path.absolute().as_uri()}?{how}",
            uri=True,
            timeout=_WAIT,
            isolation_level="IMMEDIATE",
            check_same_thread=False,  # whichever forks
        )
        try:
            _set_up(db, how)
            return _File(db, _inode(path))
        except BaseException as error:
            db.close()
            # whoever makes the table and another who turns the log on do not wait for each other
            if _code(error) != sqlite3.SQLITE_BUSY or time.monotonic() > end:
                raise
            time.sleep(0.01)


def _set_up(db: sqlite3.Connection, how: str) -> None:
    db.text_factory = bytes  # damaged text must not raise errors of its own kind
    if how == _PRIVATE:  # first of all: the next statement opens the log
        db.execute("PRAGMA locking_mode=EXCLUSIVE")
    tables = db.execute("SELECT type, name, sql FROM sqlite_master").fetchall()
    (version,) = db.execute("PRAGMA user_version").fetchone()
    if not tables and how != _CLOSED:
        with db:
            db.execute("BEGIN IMMEDIATE")
            db.execute(f"PRAGMA user_version={FORMAT}")
            db.execute(_TABLE.replace("TABLE", "TABLE IF NOT EXISTS"))
    elif version != FORMAT:
        raise DamageError(f"of version {version}: expected {FORMAT}")
    elif tables != [(b"table", b"pairs", _TABLE.encode())]:
        raise DamageError("no table of pairs")
    if how != _CLOSED:
        db.execute("PRAGMA synchronous=NORMAL")
        if db.execute("PRAGMA journal_mode=WAL").fetchone() != (b"wal",):
            raise OSError("no write-ahead log is possible")


def _is_damage(error: BaseException) -> bool:
    """Whether the file is to blame, not the machine: our SQL is right if the table is ours."""
    codes = sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR
    # Python cannot read an error message of SQLite's that quotes damaged text
    return isinstance(error, DamageError | UnicodeError) or _code(error) in codes


def _code(error: BaseException) -> int:
    return int(getattr(error, "sqlite_errorcode", 0)) & 0xFF


def _is_alive(path: Path) -> bool:
    """Whether the worker that writes a file runs on this machine."""
    name = re.fullmatch(r"pairs-(.+)-(\d+)-[0-9a-f]+\.sqlite\.open", path.name)
    return name is not None and name[1] == _HOST and Path("/proc", name[2]).exists()


def _inode(path: Path) -> int | None:
    """The file that a path leads to just now; None if it leads to none that can be reached."""
    with suppress(OSError):
        return path.stat().st_ino
    return None


def _beside(path: Path, ending: str) -> Path:
    return path.with_name(path.name + ending)


_stores: weakref.WeakSet[PairStore] = weakref.WeakSet()


def _park_all(forked: bool) -> None:
    for store in list(_stores):
        store.park(forked)


os.register_at_fork(before=lambda: _park_all(False), after_in_child=lambda: _park_all(True))
