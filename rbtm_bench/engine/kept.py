"""The files of runs that have ended, as they were: put back if a plug-in of another run changes
them."""

from __future__ import annotations

import contextlib
import os
import threading
import weakref
from pathlib import Path

from rbtm_bench.core.bounded import read_json
from rbtm_bench.core.errors import DataError

LIMIT = 500e6
"""Bytes kept at most; of files beyond that a change is noticed, but not undone."""

Signature = tuple[int, int, int, int]


class Kept:
    """The finished runs of one results folder, kept while runs with foreign plug-ins go on."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._files: dict[Path, tuple[Signature, bytes | None]] = {}
        self._bytes = 0.0
        self._lock = threading.Lock()

    def keep_all(self) -> None:
        """Keep every run in the folder that has ended."""
        self._keep(self.folder / "sweep.json")
        for record in self.folder.glob("*/run.json"):
            with contextlib.suppress(DataError):
                if read_json(record).get("status") in ("done", "failed"):
                    self.keep(record.parent)

    def keep(self, run: Path) -> None:
        """Keep a run's files, those that are not kept yet."""
        with contextlib.suppress(OSError):
            for path in run.iterdir():
                self._keep(path)

    def _keep(self, path: Path) -> None:
        with self._lock, contextlib.suppress(OSError):
            signature = _signature(path)
            if path in self._files or signature is None:
                return
            content = path.read_bytes() if self._bytes + signature[2] <= LIMIT else None
            self._bytes += 0 if content is None else len(content)
            self._files[path] = signature, content

    def put_back(self) -> list[str]:
        """The names of the files that were changed or are gone; they are as they were again."""
        changed = []
        with self._lock:
            for path, (signature, content) in list(self._files.items()):
                if _signature(path) == signature:
                    continue
                changed.append(str(path.relative_to(self.folder)))
                if content is not None:
                    _replace(path, content)
                self._files[path] = _signature(path) or signature, content
        return changed


def _signature(path: Path) -> Signature | None:
    """What changes with every write into a file; None for what is no file of its own."""
    try:
        stat = path.lstat()
    except OSError:
        return None
    own = path.is_file() and not path.is_symlink()
    return (stat.st_ino, stat.st_ctime_ns, stat.st_size, stat.st_mtime_ns) if own else None


def _replace(path: Path, content: bytes) -> None:
    """Write a file anew, whatever stands in its place."""
    with contextlib.suppress(OSError):
        if path.parent.is_symlink() or path.parent.is_file():
            path.parent.unlink()
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{os.getpid()}.partial.{path.name}")
        partial.write_bytes(content)
        os.replace(partial, path)


_known: weakref.WeakValueDictionary[Path, Kept] = weakref.WeakValueDictionary()
_lock = threading.Lock()


def of(folder: Path, make: bool = False) -> Kept | None:
    """What is kept of a results folder, by whichever thread; None if nobody keeps it."""
    with _lock:
        kept = _known.get(folder)
        if kept is None and make:
            kept = _known[folder] = Kept(folder)
        return kept
