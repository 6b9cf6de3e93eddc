"""The page on the loopback, while a sweep runs."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path

import pytest
from conftest import payload

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.page.serve import LivePage, port_of, server


@pytest.fixture
def folder(results: Path, tmp_path: Path) -> Path:
    shutil.copytree(results / "none-previous", tmp_path / "sweep" / "first")
    return tmp_path / "sweep"


@pytest.fixture
def port(folder: Path) -> Iterator[int]:
    with server(LivePage([folder], False), 0) as listening:
        thread = threading.Thread(target=listening.serve_forever)
        thread.start()
        yield port_of(listening)
        listening.shutdown()
        thread.join()


def got(port: int, path: str, host: str = "") -> tuple[int, str]:
    connection = HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request("GET", path, headers={"Host": host or f"127.0.0.1:{port}"})
    answer = connection.getresponse()
    return answer.status, answer.read().decode()


def test_a_run_that_ends_is_on_the_next_page(folder: Path, port: int, results: Path) -> None:
    status, html = got(port, "/")
    assert status == 200 and len(payload(html)["rows"]) == 1
    version = got(port, "/version")[1]
    assert payload(html)["served"] == version and "connect-src 'self'" in html
    shutil.copytree(results / "plicp-previous", folder / "second")
    assert got(port, "/version")[1] != version
    assert len(payload(got(port, "/")[1])["rows"]) == 2


def test_nothing_else_is_served(port: int) -> None:
    assert got(port, "/../../etc/passwd")[0] == 404
    assert got(port, "/first/run.json")[0] == 404
    assert got(port, "/", host="example.org")[0] == 403


def test_a_taken_port_is_one_line(port: int, folder: Path) -> None:
    with pytest.raises(ConfigError, match=f"--serve {port}"):
        server(LivePage([folder], False), port)
