"""A results folder belongs to one process at a time: claimed at once, or refused."""

from __future__ import annotations

import contextlib
import datetime
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.files import make_folder


def refuse_existing(out: Path, overwrite: bool) -> None:
    """Raise ``ConfigError`` if ``out`` holds anything already, unless it may be overwritten."""
    if out.is_dir() and any(out.iterdir()) and not overwrite:
        raise ConfigError(f"out={out}: already holds files; choose another, or overwrite=true")
    if out.exists() and not out.is_dir():
        raise ConfigError(f"out={out}: a file, expected a folder")


def lock(fd: int, how: int) -> bool:
    """Whether the lock ``how`` (``fcntl.LOCK_EX``, ``LOCK_SH``) of an open folder could be had."""
    try:
        fcntl.flock(fd, how | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks is trusted
        return True
    return True


@contextlib.contextmanager
def claimed(out: Path, overwrite: bool) -> Iterator[None]:
    """The folder for this process alone, made if need be, and empty unless it may be overwritten.

    Raises ``ConfigError`` if another process has it, or if it holds files. A folder that nothing
    was written into goes again. File systems without locks are trusted.
    """
    with contextlib.ExitStack() as stack:
        fd = _opened(out)
        if fd is not None:
            stack.callback(os.close, fd)
            stack.callback(_remove_if_empty, out)
        refuse_existing(out, overwrite)
        yield


def _opened(out: Path) -> int | None:
    """The folder, open and locked; None where it cannot be opened, as on some file systems."""
    while True:
        make_folder(out)
        try:
            fd = os.open(out, os.O_RDONLY)
        except FileNotFoundError:
            continue  # whoever made it has just given it up
        except OSError:
            return None
        if not lock(fd, fcntl.LOCK_EX):
            os.close(fd)
            raise ConfigError(f"out={out}: another process is at work there")
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(fd), os.stat(out)):
                return fd
        os.close(fd)


def default_folder(kind: str, choices: dict[str, str] | None = None) -> str:
    """results/<kind>/<time>[-<data set>-<backend>-<selector>], a new one every time."""
    stamp = datetime.datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    names = [choices[group] for group in ("dataset", "backend", "selector")] if choices else []
    return str(new_folder("-".join([f"results/{kind}/{stamp}", *names])))


def new_folder(stem: str) -> Path:
    """A folder of this name that did not exist, made: two processes never get the same."""
    folder, count = Path(stem), 1
    while True:
        try:
            make_folder(folder.parent)
            folder.mkdir()
            return folder
        except FileExistsError:
            count += 1
            folder = Path(f"{stem}-{count}")


def _remove_if_empty(folder: Path) -> None:
    with contextlib.suppress(OSError):
        folder.rmdir()
