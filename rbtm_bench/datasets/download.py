"""Fetch published logs: resumed where a transfer broke off, held against what is known of them.

A file appears under its name when its content is right and not before; until then it is
``NAME.part``. The transfer is pooch's, which by itself begins anew after a break.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from rbtm_bench.core.errors import DataError, RunError
from rbtm_bench.core.files import write_text
from rbtm_bench.datasets.carmen_log import parse_relations
from rbtm_bench.datasets.files import read_bytes
from rbtm_bench.datasets.published import (
    RECORDS,
    SERVER,
    Remote,
    content_sha256,
    present,
    recorded,
)
from rbtm_bench.datasets.recognise import is_log

TIMEOUT_S = (10.0, 30.0)
"""To connect, and between two pieces."""
PIECE = 1 << 13
"""Bytes at a time; a break loses the piece that it is in."""
BREAKS = 5
"""Breaks of a transfer that got further each time, and is gone on with at once."""
LARGEST = 500 << 20
"""Bytes of a log whose size is not known: ten times the largest."""

Progress = Callable[[float, int | None, str], None]
"""Called with the bytes so far, in all (None: not known), and a note."""


@dataclass(frozen=True)
class Outcome:
    """A file on this machine: whether it was fetched now, and what its content was held against."""

    path: Path
    fetched: bool
    check: str


def fetch(file: Remote, folder: Path, progress: Progress, server: str = SERVER) -> Outcome:
    """Make sure that ``file`` is in ``folder`` and holds what it should.

    Parameters
    ----------
    file
        What to fetch from ``server``, an address that its name is put behind.
    folder
        Where it goes, and where an interrupted transfer waits.
    progress
        Told how far the transfer is.

    Returns
    -------
    Outcome

    Raises
    ------
    RunError
        The transfer failed, or brought something else: one line with the address.
    DataError
        The file is present and is not what was published.
    """
    have = present(file, folder)
    if have is not None:
        known = file.sha256 or recorded(have)
        if known not in (None, content_sha256(have)):
            raise DataError(f"{have}: not what was published (sha256): remove it to fetch it anew")
        check = "checksum right" if file.sha256 else "as first downloaded, unverified"
        return Outcome(have, False, check if known else "unverified, no checksum is known")
    path = folder / file.name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        transfer = _Transfer(f"{server.rstrip('/')}/{file.name}", path, file, progress)
        transfer.run()
        check = transfer.checked()
        os.replace(transfer.part, path)
    except OSError as error:
        raise RunError(f"{path}: cannot be written: {error.strerror or error}") from error
    return Outcome(path, True, check)


class _Transfer:
    """One file over HTTP into ``path.part``."""

    def __init__(self, url: str, path: Path, file: Remote, progress: Progress) -> None:
        self.url, self.path, self.file, self.progress = url, path, file, progress
        self.part = path.with_name(f"{path.name}.part")
        self.version = path.with_name(f"{path.name}.part.version")
        """What the server called the version that the part is of."""
        self.total: int | None = None
        self._out: BinaryIO | None = None

    def run(self) -> None:
        """Fetch what is missing of the part. Raises ``RunError`` where that cannot be done."""
        for _ in range(BREAKS):
            before = self._size()
            broke = self._piece(before)
            if broke is None:
                return
            if self._size() == before:
                break
        raise RunError(
            f"{self.url}: the transfer broke off after {self._size()} bytes ({broke}): "
            "the same command goes on from there"
        )

    def checked(self) -> str:
        """What the part's content was held against. Raises ``RunError`` for a wrong one, which is
        thrown away."""
        try:
            sha256 = content_sha256(self.part)
            if self.file.sha256 is None:
                _plausible(self.part)
        except DataError as error:
            why = str(error).removeprefix(f"{self.part}: ").removeprefix(f"{self.part}, ")
            self._forget()
            raise RunError(f"{self.url}: not the published file: {why}") from error
        if self.file.sha256 not in (None, sha256):
            self._forget()
            raise RunError(f"{self.url}: not the published file: its checksum is wrong")
        self.version.unlink(missing_ok=True)
        if self.file.sha256:
            return "checksum right"
        before = recorded(self.path)
        write_text(self.path.with_name(self.path.name + RECORDS), f"{sha256}  {self.path.name}\n")
        if before not in (None, sha256):
            return f"unverified, and not what was downloaded before (sha256 {before})"
        return f"unverified, no checksum is known; recorded: sha256 {sha256}"

    def write(self, piece: bytes) -> int:
        """Take a piece of the content: for pooch this is the file it writes to."""
        assert self._out is not None
        written = self._out.write(piece)
        at = self._out.tell()
        largest = LARGEST if self.file.size is None else self.file.size
        if at > largest:
            raise RunError(f"{self.url}: not the published file: larger than {largest} bytes")
        self.progress(at, self.total, self.file.name)
        return written

    def flush(self) -> None:
        """Nothing: the part is closed after every transfer."""

    def _piece(self, before: int) -> str | None:
        """Go on after ``before`` bytes; why the transfer broke off, None if it did not."""
        import pooch
        from requests import exceptions

        headers = {"Accept-Encoding": "identity"}
        version = self.version.read_text() if self.version.is_file() else ""
        if before and (version or self.file.sha256):
            headers["Range"] = f"bytes={before}-"
            headers.update({"If-Range": version} if version else {})
        get = pooch.HTTPDownloader(
            chunk_size=PIECE,
            timeout=TIMEOUT_S,
            headers=headers,
            hooks={"response": self._answered},
        )
        try:
            with open(self.part, "ab") as self._out:
                get(self.url, self, None)
        except exceptions.HTTPError as error:
            answer: Any = error.response
            if answer.status_code == 416 and before:
                return self._beyond(answer, before)
            raise RunError(f"{self.url}: {answer.status_code} {answer.reason}") from error
        except exceptions.TooManyRedirects as error:
            raise RunError(f"{self.url}: redirected for ever") from error
        except exceptions.RequestException as error:
            if self._size() > before or before:
                return type(error).__name__
            why = type(error).__name__
            raise RunError(f"{self.url}: no answer, or a broken one ({why})") from error
        except RunError:
            self._forget()
            raise
        finally:
            if self._size() == 0:
                self._forget()
        return None

    def _answered(self, answer: Any, *_: Any, **__: Any) -> None:
        """The head of an answer, before its body: what the body is a part of."""
        if answer.status_code not in (200, 206):
            return
        assert self._out is not None
        length = answer.headers.get("Content-Length", "")
        size = int(length) if length.isdecimal() else None
        if answer.status_code == 200:
            self._out.truncate(0)
            self._out.seek(0)
            start = 0
        else:
            start = self._size()
            if not answer.headers.get("Content-Range", "").startswith(f"bytes {start}-"):
                raise RunError(f"{self.url}: the server resumes at another place")
        self.total = None if size is None else start + size
        tag = answer.headers.get("ETag", "")
        weak = not tag or tag.startswith("W/")
        version = answer.headers.get("Last-Modified", "") if weak else tag
        self.version.write_text(version)

    def _beyond(self, answer: Any, before: int) -> str | None:
        """A range that the server has not: None if nothing is missing, else the part goes."""
        if answer.headers.get("Content-Range", "").endswith(f"/{before}"):
            return None
        self._forget()
        return "the part was longer than the file"

    def _size(self) -> int:
        return self.part.stat().st_size if self.part.is_file() else 0

    def _forget(self) -> None:
        self.part.unlink(missing_ok=True)
        self.version.unlink(missing_ok=True)


def _plausible(path: Path) -> None:
    """Raises ``DataError`` for what is neither a log nor relations: a page with an error, say."""
    if path.name.endswith(".relations.part"):
        parse_relations(str(path), read_bytes(path))
    elif not is_log(path):
        raise DataError(f"{path}: no CARMEN log")
