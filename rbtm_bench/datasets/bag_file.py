"""The messages of a bag (ROS 1, ROS 2 db3 and mcap), read by rosbags: what it raises becomes ours.

Sizes in a bag are claims: packed chunks are unpacked up to a limit, and the messages that come are
counted against those that the index promises.
"""

from __future__ import annotations

import bz2
import contextlib
import functools
import hashlib
import os
import threading
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rbtm_bench.core.errors import ConfigError, DataError, RbtmBenchError
from rbtm_bench.datasets.files import UNPACKED_ALWAYS, UNPACKED_TIMES, file_size

MAGIC = {b"#ROSBAG V": ".bag", b"\x89MCAP0\r\n": ".mcap", b"SQLite format 3\0": ".db3"}
"""First bytes of the files of bags, and the suffix by which rosbags tells them."""
METADATA = "metadata.yaml"
FORWARD = 1000
"""Messages that are passed over rather than looked up by their time."""


@dataclass(frozen=True)
class Topic:
    """A topic of a bag: its name, type and number of messages."""

    name: str
    type: str
    count: int

    def __str__(self) -> str:
        return f"{self.name} ({self.type.replace('/msg/', '/')}, {self.count})"


@dataclass(frozen=True)
class Message:
    """A message with its topic, the ``time`` (ns) it was recorded at, and its ``rank`` among those
    of the same time: the two find it again."""

    topic: str
    time: int
    rank: int
    content: Any


def magic_suffix(path: Path) -> str | None:
    """The suffix that a bag's file should have by its first bytes; None for other files."""
    with open(path, "rb") as file:
        start = file.read(16)
    return next((suffix for magic, suffix in MAGIC.items() if start.startswith(magic)), None)


def bag_files(path: str) -> list[Path]:
    """The files of the bag at ``path``, a file or a ROS 2 folder. Raises ``DataError``."""
    place = Path(path)
    if not place.is_dir():
        file_size(place)
        suffix = magic_suffix(place)
        if suffix is None:
            raise DataError(f"{path}: no bag: it starts like no ROS 1 bag, db3 or mcap file")
        if place.suffix != suffix:
            raise DataError(f"{path}: a bag whose name must end in {suffix}")
        return [place]
    if not (place / METADATA).is_file():
        raise DataError(f"{path}: no {METADATA} of a ROS 2 bag; a single bag's file can be named")
    files = sorted(file for file in place.iterdir() if file.suffix in MAGIC.values())
    for file in (place / METADATA, *files):
        file_size(file)
    return [place / METADATA, *files]


def content_digest(path: str) -> str:
    """sha256 of a bag's files."""
    digest = hashlib.sha256()
    for file in bag_files(path):
        with open(file, "rb") as content:
            digest.update(hashlib.file_digest(content, "sha256").digest())
    return digest.hexdigest()


@contextlib.contextmanager
def told(path: str) -> Iterator[None]:
    """Whatever is raised inside as a ``DataError`` of one line that names the bag."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except RbtmBenchError:
        raise
    except MemoryError:
        raise DataError(f"{path}: does not fit into memory") from None
    except Exception as error:  # a bare AssertionError among them
        text = " ".join(f"{type(error).__name__}: {error}".split())[:200].rstrip(": ")
        raise DataError(f"{path}: a damaged bag ({text})") from error


@contextlib.contextmanager
def opened(path: str) -> Iterator[Any]:
    """rosbags' reader of the bag. Raises ``ConfigError`` if rosbags is not installed."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise ConfigError("bags need the package rosbags: pip install rbtm-bench[bags]") from None
    bag_files(path)
    store = get_typestore(Stores.ROS2_HUMBLE)  # for db3 files, which may not define their types
    with told(path):
        reader = AnyReader([Path(path)], default_typestore=store)
        reader.open()
    try:
        with told(path):
            _limit(reader, path)
            _hold_counts(reader, path)
        yield reader
    finally:
        with contextlib.suppress(Exception):
            reader.close()


def topics(path: str) -> list[Topic]:
    """The topics of a bag by name; one that is recorded over several connections counts once."""
    with opened(path) as reader, told(path):
        return [
            Topic(name, str(info.msgtype), int(info.msgcount))
            for name, info in sorted(reader.topics.items())
        ]


def messages(path: str, names: set[str], start: int | None = None) -> Iterator[Message]:
    """The messages of some topics in the order of recording, from the time ``start`` (ns) on.

    Raises ``DataError`` where the bag is damaged, and at its end if messages are missing.
    """
    with opened(path) as reader:
        yield from _messages(reader, path, names, start)


def _messages(reader: Any, path: str, names: set[str], start: int | None) -> Iterator[Message]:
    with told(path):
        chosen = [one for one in reader.connections if one.topic in names]
    if not chosen:
        return
    expected = sum(one.msgcount for one in chosen)
    stream = reader.messages(connections=chosen, start=start)
    ranks: dict[str, tuple[int, int]] = {}
    count = 0
    while True:
        with told(path):
            found = next(stream, None)
            if found is None:
                break
            connection, time, raw = found
            content = reader.deserialize(raw, connection.msgtype)
        before, rank = ranks.get(connection.topic, (time - 1, 0))
        rank = rank + 1 if time == before else 0
        ranks[connection.topic] = (time, rank)
        count += 1
        yield Message(connection.topic, time, rank, content)
    if start is None and count != expected:
        raise DataError(f"{path}: {expected} messages announced, {count} found")


class Cursor:
    """Messages of one topic by time and rank; those that follow each other are read on.

    A process that was forked opens the bag again: the two would move the same place in the file.
    """

    def __init__(self, path: str, topic: str) -> None:
        self._path, self._topic = path, topic
        self._stream: Iterator[Message] | None = None
        self._open: contextlib.AbstractContextManager[Any] | None = None
        self._reader: Any = None
        self._owner = self._next = -1
        self._lock = threading.Lock()

    def message(self, index: int, time: int, rank: int) -> Any:
        """The content of message ``index`` of the topic."""
        with self._lock:
            if self._owner != os.getpid():
                self._open = opened(self._path)  # kept: it closes the bag when it goes
                self._reader, self._stream = self._open.__enter__(), None
                self._owner = os.getpid()
            if not 0 <= index - self._next < FORWARD or self._stream is None:
                self._stream = _messages(self._reader, self._path, {self._topic}, time)
            self._next = index + 1
            for message in self._stream:
                if (message.time, message.rank) == (time, rank):
                    return message.content
            self._stream = None
        raise DataError(f"{self._path}: message {index} of {self._topic} is gone: has it changed?")


def _limit(reader: Any, path: str) -> None:
    """Unpack the chunks of a ROS 1 bag up to a limit."""
    from lz4.frame import LZ4FrameDecompressor
    from rosbags.rosbag1.reader import decompressors

    makers: dict[str, Callable[[], Any]] = {"bz2": bz2.BZ2Decompressor, "lz4": LZ4FrameDecompressor}
    limited = {
        decompressors[name]: functools.partial(_unpacked, path, make)
        for name, make in makers.items()
    }
    for one in reader.readers:
        chunks = getattr(one, "chunks", None)
        if not isinstance(chunks, dict):
            continue  # rosbags holds those of mcap against the size that they tell
        for place, chunk in chunks.items():
            unpack = limited.get(chunk.decompressor, chunk.decompressor)
            chunks[place] = chunk._replace(decompressor=unpack)


def _unpacked(path: str, make: Callable[[], Any], packed: bytes) -> bytes:
    most = max(UNPACKED_ALWAYS, UNPACKED_TIMES * len(packed))
    unpacker = make()
    content: bytes = unpacker.decompress(packed, most)
    if not unpacker.eof:
        raise DataError(f"{path}: a chunk is cut short, or unpacks to more than {most} bytes")
    return content


def _hold_counts(reader: Any, path: str) -> None:
    """A ROS 1 bag counts its messages twice: with its chunks and in their indices."""
    for name, info in reader.topics.items():
        indexed = sum(one.msgcount for one in reader.connections if one.topic == name)
        if indexed != info.msgcount:
            raise DataError(f"{path}: {info.msgcount} messages of {name}, {indexed} in the index")
