"""The files of the pair store: opening, checking, locking, naming. They decide nothing.

Every function may raise what ``TROUBLE`` lists; ``store`` turns that into notes.
"""

from __future__ import annotations

import fcntl
import os
import platform
import re
import secrets
import sqlite3
import time
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import IO, Literal, NamedTuple

from rbtm_bench.core.files import write_atomically
from rbtm_bench.pairs.codec import FORMAT, DamageError

NAME = "pairs.sqlite"
"""The shared store in its folder."""
LOCK = "pairs.lock"
"""Locked while a process opens, closes or sets aside; holds the stamp of a clean store."""
TROUBLE = (sqlite3.Error, OSError, MemoryError, UnicodeError, DamageError)

How = Literal["shared", "alone", "sealed"]
_OPTIONS = {
    "shared": "mode=rw",  # locks and a write-ahead log: the processes of one machine
    "alone": "mode=rw&vfs=unix-none",  # this process only: asks for no locks
    "sealed": "mode=ro&immutable=1",  # nobody writes any more: no locks either
}
_JOURNAL = {"shared": b"wal", "alone": b"delete"}
_BESIDE = ("-wal", "-shm", "-journal")
_APPLICATION = 0x7262746D  # "rbtm"
_SCHEMA = "CREATE TABLE pairs (key BLOB PRIMARY KEY, value BLOB NOT NULL) WITHOUT ROWID"
_WAIT = 60.0  # s for a lock
_LARGE = 1_000_000_000  # bytes: looking through more would keep others waiting


class StoreFile(NamedTuple):
    """A store that is open."""

    path: Path
    db: sqlite3.Connection
    inode: int


def create(path: Path) -> None:
    """Make an empty store; it appears whole, and what an earlier one left beside it goes."""
    for ending in _BESIDE:  # SQLite would add what it finds in them
        _beside(path, ending).unlink(missing_ok=True)
    clear_partial(path.parent, path.name)
    write_atomically(path, _create)


def open_store(path: Path, how: How) -> StoreFile:
    """Open a store that exists and see that it is one."""
    db = _connect(path, how)
    try:
        _verify(db)
        if journal := _JOURNAL.get(how):
            (mode,) = db.execute(f"PRAGMA journal_mode={journal.decode()}").fetchone()
            if mode != journal:
                raise OSError(f"no {journal.decode()} journal is possible: use mode per_worker")
        return StoreFile(path, db, path.stat().st_ino)
    except BaseException:
        db.close()
        raise


def insert(db: sqlite3.Connection, rows: Iterable[tuple[bytes, bytes]]) -> None:
    """Write pairs in one short transaction; a pair that is stored stays as it is."""
    try:
        db.execute("BEGIN IMMEDIATE")
        db.executemany("INSERT OR IGNORE INTO pairs VALUES (?, ?)", rows)
        db.execute("COMMIT")
    except BaseException:
        with suppress(sqlite3.Error):
            db.execute("ROLLBACK")
        raise


def check_shared(path: Path, clean: str, how: How) -> None:
    """Check a store before it is opened for sharing; ``clean`` is the stamp of its last closing.

    Its pages are looked through only if it was not closed cleanly, and not while others have it
    open (the first of them has looked) or if they are more than 1 GB. In any case every
    value carries a checksum of its own.
    """
    if clean and clean == stamp(path):
        return
    try:
        with closing(_connect(path, how, wait=0)) as db:
            _verify(db)
            if path.stat().st_size <= _LARGE:
                check_pages(db)
    except sqlite3.Error as error:
        if _code(error) != sqlite3.SQLITE_BUSY:
            raise


def check_pages(db: sqlite3.Connection) -> None:
    """Let SQLite look through all pages: about 1 ms a MB."""
    (verdict,) = db.execute("PRAGMA quick_check(1)").fetchone()
    if verdict != b"ok":
        raise DamageError(verdict.decode(errors="replace").replace("\n", " "))


def stamp(path: Path) -> str:
    """What a closed store looks like; empty if it is in use or its last user was killed."""
    if _beside(path, "-wal").exists():
        return ""
    stat = path.stat()
    return f"{stat.st_size} {stat.st_mtime_ns}"


def is_damage(error: BaseException, opening: bool = False) -> bool:
    """Whether the file is to blame, not the machine. An SQL error says so only at opening."""
    codes = [sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB] + [sqlite3.SQLITE_ERROR] * opening
    # Python cannot read an error message of SQLite's that quotes damaged text
    return isinstance(error, DamageError | UnicodeError) or _code(error) in codes


def set_aside(path: Path) -> Path:
    """Rename a file, and what belongs to it, to the first free ``<name>.damaged-<n>``."""
    n = 1
    while _beside(path, f".damaged-{n}").exists():
        n += 1
    aside = _beside(path, f".damaged-{n}")
    for ending in ("", *_BESIDE):
        with suppress(FileNotFoundError):  # it has none, or another process was faster
            os.rename(_beside(path, ending), _beside(aside, ending))
    return aside


def remove(path: Path) -> None:
    """Delete a store that is closed."""
    for ending in ("", *_BESIDE):
        _beside(path, ending).unlink(missing_ok=True)


def clear_partial(folder: Path, name: str) -> None:
    """Delete what processes left that were killed while they made a store called ``name``."""
    for path in folder.glob(f".*.partial.{name}*"):
        path.unlink(missing_ok=True)


def inode(path: Path) -> int | None:
    """The file that a path leads to just now; None if it leads to none."""
    try:
        return path.stat().st_ino
    except FileNotFoundError:
        return None


@contextmanager
def locked(folder: Path) -> Iterator[IO[str]]:
    """One process at a time, for a moment. Raises ``OSError`` where files cannot be locked."""
    with open(folder / LOCK, "a+", errors="replace") as lock:
        end = time.monotonic() + _WAIT
        while not _lock(lock):
            if time.monotonic() > end:
                raise TimeoutError(f"{lock.name} has been locked for {_WAIT:.0f} s")
            time.sleep(0.01)
        lock.seek(0)
        yield lock


def can_lock(folder: Path) -> bool:
    """Whether the file system of a folder has locks, be it only for one machine."""
    try:
        with locked(folder):
            return True
    except TimeoutError:
        return True
    except OSError:
        return False


def new_worker_path(folder: Path) -> Path:
    """The name of a worker's own file; ``.open`` goes when the worker closes it."""
    name = f"pairs-{_host()}-{os.getpid()}-{secrets.token_hex(4)}.sqlite.open"
    return folder / name


def sealed_files(folder: Path) -> list[Path]:
    """Workers' files that nobody writes any more."""
    return sorted(folder.glob("pairs-*.sqlite"))


def killed_files(folder: Path) -> list[Path]:
    """Workers' files that were never sealed, without those of processes alive on this machine."""
    return [path for path in sorted(folder.glob("pairs-*.sqlite.open")) if not _is_alive(path)]


def is_quiet(path: Path) -> bool:
    """Whether a store exists and nothing says that it is being written."""
    return path.exists() and not any(_beside(path, ending).exists() for ending in _BESIDE)


def _connect(path: Path, how: How, wait: float = _WAIT) -> sqlite3.Connection:
    """Connect; without any ``wait`` (s) for others, raises SQLITE_BUSY if any have it open."""
    # no mmap_size: a file that somebody cuts off would end the process with SIGBUS
    uri = f"{path.absolute().as_uri()}?{_OPTIONS[how]}"
    db = sqlite3.connect(uri, uri=True, timeout=wait, isolation_level=None)
    db.text_factory = bytes  # damaged text must not raise errors of its own kind
    try:
        if how == "alone" or not wait:  # first of all: the next statement opens the log
            db.execute("PRAGMA locking_mode=EXCLUSIVE")
        db.execute("PRAGMA synchronous=NORMAL")
        db.execute("PRAGMA cache_size=-8000")
    except BaseException:
        db.close()
        raise
    return db


def _create(path: Path) -> None:
    path.touch()
    with closing(_connect(path, "alone")) as db:
        db.execute("PRAGMA synchronous=OFF")  # an empty store is no loss
        db.execute("BEGIN")
        db.execute(f"PRAGMA application_id={_APPLICATION}")
        db.execute(f"PRAGMA user_version={FORMAT}")
        db.execute(_SCHEMA)
        db.execute("COMMIT")


def _verify(db: sqlite3.Connection) -> None:
    for pragma, expected in (("application_id", _APPLICATION), ("user_version", FORMAT)):
        (value,) = db.execute(f"PRAGMA {pragma}").fetchone()
        if value != expected:
            raise DamageError(f"{pragma} {value}: expected {expected}")
    schema = db.execute("SELECT type, name, sql FROM sqlite_master").fetchall()
    if schema != [(b"table", b"pairs", _SCHEMA.encode())]:
        raise DamageError("another schema")


def _lock(lock: IO[str]) -> bool:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        why = f"files cannot be locked ({error.strerror}): use mode per_worker"
        raise OSError(error.errno, why) from error
    return True


def _is_alive(path: Path) -> bool:
    match = re.fullmatch(r"pairs-(.+)-(\d+)-[0-9a-f]+\.sqlite\.open", path.name)
    if not match or match[1] != _host():
        return False
    try:
        os.kill(int(match[2]), 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True


def _host() -> str:
    return re.sub(r"[^A-Za-z0-9.]", "_", platform.node()) or "host"


def _beside(path: Path, ending: str) -> Path:
    return path.with_name(path.name + ending)


def _code(error: BaseException) -> int:
    return int(getattr(error, "sqlite_errorcode", 0)) & 0xFF
