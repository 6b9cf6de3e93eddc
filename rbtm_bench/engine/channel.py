"""How parent and child talk: whole messages, each behind a word that both know.

What a plug-in writes onto the channel is noticed, and read by nobody as a message; half a message
keeps nobody waiting. From a child with foreign plug-ins plain data is taken, and our own errors.
"""

from __future__ import annotations

import io
import pickle
import select
import socket
import struct
import time
from typing import Any

_LENGTH = struct.Struct(">Q")
CHUNK = 1 << 16
ERRORS = "rbtm_bench.core.errors"


class GarbageError(Exception):
    """What came over the channel is no message."""


class Channel:
    """One end. ``plain``: of what comes, only plain data and our own errors are believed."""

    def __init__(self, end: socket.socket, word: bytes, plain: bool = False) -> None:
        self._end, self._word, self._plain = end, word, plain
        self._buffer = bytearray()

    def send(self, value: Any) -> None:
        """Send anything that can be pickled. Raises ``OSError`` if nobody is there."""
        self.send_bytes(pickle.dumps(value))

    def send_bytes(self, message: bytes) -> None:
        """Send what ``pickle.dumps`` made."""
        self._end.sendall(self._word + _LENGTH.pack(len(message)) + message)

    def receive(self, timeout: float | None = None) -> Any:
        """The next message. Raises ``TimeoutError``, ``EOFError`` if the other end is closed,
        ``GarbageError`` for what is none."""
        message = self.receive_bytes(timeout)
        try:
            return _Plain(io.BytesIO(message)).load() if self._plain else pickle.loads(message)
        except Exception as error:
            raise GarbageError(f"an answer that cannot be read: {type(error).__name__}") from error

    def receive_bytes(self, timeout: float | None = None) -> bytes:
        """The same, still pickled."""
        deadline = None if timeout is None else time.monotonic() + timeout
        poll = select.poll()
        poll.register(self._end, select.POLLIN)
        while (message := self._whole()) is None:
            left = None if deadline is None else max(0.0, deadline - time.monotonic()) * 1000
            if not poll.poll(left):
                raise TimeoutError
            chunk = self._end.recv(CHUNK)
            if not chunk:
                raise EOFError
            self._buffer += chunk
        return message

    def _whole(self) -> bytes | None:
        """The first message in the buffer, if all of it is there."""
        head = len(self._word) + _LENGTH.size
        start = bytes(self._buffer[: len(self._word)])
        if start != self._word[: len(start)]:
            raise GarbageError("it wrote onto the channel to its parent")
        if len(self._buffer) < head:
            return None
        stop = head + _LENGTH.unpack_from(self._buffer, len(self._word))[0]
        if len(self._buffer) < stop:
            return None
        message = bytes(self._buffer[head:stop])
        del self._buffer[:stop]
        return message

    def close(self) -> None:
        """Hang up."""
        self._end.close()


class _Plain(pickle.Unpickler):
    """Reads what can run no code: a plug-in may have sent it."""

    def find_class(self, module: str, name: str) -> Any:
        if module == ERRORS and name.endswith("Error"):
            return super().find_class(module, name)
        raise pickle.UnpicklingError(f"{module}.{name} is no plain data")
