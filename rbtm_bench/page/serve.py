"""The page on this machine's loopback, made again when the folders have changed."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from socketserver import BaseServer
from typing import Any

from rbtm_bench.core.errors import ConfigError, one_line
from rbtm_bench.page import assemble

HOST = "127.0.0.1"
WATCHED = ("run.json", "metrics.json")
"""Files of a run that are written when it starts and when it ends."""


class LivePage:
    """The newest page of some folders, made when it is asked for and anything has changed."""

    def __init__(self, paths: Sequence[Path], trust: bool) -> None:
        self._paths, self._trust = paths, trust
        self._lock = threading.Lock()
        self._made = ""
        self._html = b""

    def version(self) -> str:
        """Changes with every run that starts or ends."""
        seen = hashlib.sha256()
        for path in self._paths:
            for file in sorted(f for name in WATCHED for f in path.rglob(name)):
                try:
                    known = file.stat()
                except OSError:
                    continue
                seen.update(
                    f"{file} {known.st_mtime_ns} {known.st_size}\n".encode(errors="replace")
                )
        return seen.hexdigest()[:16]

    def html(self) -> bytes:
        """The page as it is now. Raises ``DataError`` where no run can be read."""
        with self._lock:
            version = self.version()
            if version != self._made:
                text, _ = assemble.page(self._paths, self._trust, version)
                self._html, self._made = text.encode(), version
            return self._html


def port_of(server: BaseServer) -> int:
    """The port that a server listens to."""
    address: Any = server.server_address
    return int(address[1])


def server(page: LivePage, port: int) -> ThreadingHTTPServer:
    """A server on the loopback; port 0: any free one. Raises ``ConfigError`` for a taken one."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            here = f":{port_of(self.server)}"
            if self.headers.get("Host") not in (HOST + here, f"localhost{here}"):
                self.send_error(403, "asked for under another name")  # a name that was rebound
            elif self.path == "/version":
                self._answer(page.version().encode(), "text/plain")
            elif self.path == "/":
                try:
                    self._answer(page.html(), "text/html; charset=utf-8")
                except (
                    Exception
                ) as error:  # a half-written run may be the cause: the next asks again
                    self._answer(one_line(error).encode(errors="replace"), "text/plain")
            else:
                self.send_error(404)

        def _answer(self, body: bytes, kind: str) -> None:
            self.send_response(200)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            self.send_header("X-Content-Type-Options", "nosniff")
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            """Nothing: the terminal is the sweep's."""

    try:
        return ThreadingHTTPServer((HOST, port), Handler)
    except (OSError, OverflowError) as error:
        raise ConfigError(f"--serve {port}: {error}: expected a free port, or 0") from error
