"""``rbtm-bench download`` against a server that breaks off, lies, is not there, and redirects."""

from __future__ import annotations

import dataclasses
import gzip
import hashlib
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from rbtm_bench.cli.commands import main
from rbtm_bench.datasets import download, published
from rbtm_bench.datasets.download import PIECE
from rbtm_bench.datasets.published import PUBLISHED, Remote

BEAMS = b" ".join(b"%d.25" % (2 + beam // 3) for beam in range(180))
LOG = b"".join(
    b"FLASER 180 %s %d.5 0 0 %d.5 0 0 %d.5 host %d.5\n" % (BEAMS, i, i, i, i) for i in range(100)
)
RELATIONS = b"0.5 1.5 0 0 0 0 0 0\n"
CONTENT = {"aces.clf": LOG, "aces.relations": RELATIONS}


def remote(name: str, known: bool = True) -> Remote:
    content = CONTENT[name]
    return (
        Remote(name, len(content), hashlib.sha256(content).hexdigest()) if known else Remote(name)
    )


class Server(ThreadingHTTPServer):
    """Serves ``files``; ``cuts`` holds, for the answers to come, after how many bytes they break
    off; ``ranges`` and ``whole`` what was asked for."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.files = dict(CONTENT)
        self.cuts: list[int] = []
        self.ranges: list[str | None] = []
        self.honours_range, self.redirects, self.tag = True, "", '"1"'
        self.url = f"http://127.0.0.1:{self.server_port}"


class Handler(BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        server, name = self.server, self.path.rpartition("/")[2]
        if server.redirects and not self.path.startswith("/moved/"):
            self.send_response(302)
            self.send_header("Location", server.redirects + name)
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        asked = self.headers.get("Range")
        server.ranges.append(asked)
        content = server.files.get(name)
        if content is None:
            self.send_error(404)
            return
        same = self.headers.get("If-Range") in (None, server.tag)
        start = int(asked[6:-1]) if asked and server.honours_range and same else 0
        if start >= len(content):
            self.send_response(416)
            self.send_header("Content-Range", f"bytes */{len(content)}")
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        self.send_response(206 if start else 200)
        if start:
            self.send_header("Content-Range", f"bytes {start}-{len(content) - 1}/{len(content)}")
        self.send_header("Content-Length", str(len(content) - start))
        if server.tag:
            self.send_header("ETag", server.tag)
        self.end_headers()
        end = start + server.cuts.pop(0) if server.cuts else len(content)
        self.wfile.write(content[start:end])
        self.close_connection = True

    def log_message(self, *_: Any) -> None:
        """Nothing on standard error."""


@pytest.fixture
def server() -> Iterator[Server]:
    with Server() as running:
        thread = threading.Thread(target=running.serve_forever, args=(0.01,))
        thread.start()
        yield running
        running.shutdown()
        thread.join()


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of data of its own, and an aces that is small."""
    monkeypatch.setenv(published.DATA, str(tmp_path))
    small = dataclasses.replace(
        PUBLISHED["aces"], log=remote("aces.clf"), relations=remote("aces.relations")
    )
    monkeypatch.setitem(PUBLISHED, "aces", small)
    return tmp_path


def fetch(server: Server, folder: Path, file: Remote | None = None) -> download.Outcome:
    steps: list[tuple[float, int | None]] = []
    outcome = download.fetch(
        file or remote("aces.clf"),
        folder,
        lambda done, total, note: steps.append((done, total)),
        server.url,
    )
    assert not outcome.fetched or not steps or steps[-1][0] == outcome.path.stat().st_size
    return outcome


def leavings(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if ".part" in path.name)


def test_what_is_fetched_is_read_by_its_name(
    server: Server, home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["dataset=aces", "backend=none", "selector=previous", "pictures=false", "pin=false"]
    assert main(["run", *words, f"out={home / 'out'}"]) == 2
    assert "rbtm-bench download aces" in capsys.readouterr().err
    assert main(["download", "aces", "--from", server.url + "/"]) == 0
    told = capsys.readouterr().out
    assert "CC BY 3.0" in told and "Kuemmerle" in told and "checksum right" in told
    assert (home / "freiburg" / "aces.clf").read_bytes() == LOG
    assert leavings(home / "freiburg") == []
    assert main(["run", *words, "dataset.max_scans=20", f"out={home / 'out'}"]) == 0
    assert main(["data", "dataset=aces"]) == 0
    assert "100, planar" in capsys.readouterr().out
    assert main(["list", "datasets"]) == 0
    told = capsys.readouterr().out
    assert f"[present, {home / 'freiburg' / 'aces.clf'}]" in told
    assert "[not present: rbtm-bench download intel]" in told
    server.files.clear()
    assert main(["download", "aces"]) == 0  # asks no server
    assert "present" in capsys.readouterr().out


def test_an_unknown_name(server: Server, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["download", "ace", "--from", server.url]) == 2
    assert "Did you mean aces?" in capsys.readouterr().err
    assert server.ranges == []


def test_without_a_name_it_lists(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["download"]) == 0
    told = capsys.readouterr().out
    assert all(name in told for name in PUBLISHED) and "not present" in told


def test_a_break_is_gone_on_with_at_once(server: Server, tmp_path: Path) -> None:
    server.cuts = [6 * PIECE + 5, 3 * PIECE]
    outcome = fetch(server, tmp_path)
    assert outcome.path.read_bytes() == LOG
    assert server.ranges == [None, *(f"bytes={n * PIECE}-" for n in (6, 9))]


def test_breaks_without_an_end_are_gone_on_with_by_the_same_command(
    server: Server, home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    server.cuts = [7 * PIECE, 0]
    assert main(["download", "aces", "--from", server.url]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "broke off after 57344 bytes" in error
    assert (home / "freiburg" / "aces.clf.part").stat().st_size == 7 * PIECE
    assert not (home / "freiburg" / "aces.clf").exists()
    assert main(["download", "aces", "--from", server.url]) == 0
    assert "bytes=57344-" in server.ranges
    assert (home / "freiburg" / "aces.clf").read_bytes() == LOG


@pytest.mark.parametrize("way", ["no ranges", "another version", "part too long", "complete"])
def test_a_part_that_the_server_does_not_go_on_with(
    server: Server, tmp_path: Path, way: str
) -> None:
    server.cuts = [40_000, 0]
    with pytest.raises(download.RunError, match="broke off"):
        fetch(server, tmp_path)
    if way == "no ranges":
        server.honours_range = False
    elif way == "another version":
        server.tag = '"2"'
        (tmp_path / "aces.clf.part").write_bytes(b"x" * 40_000)
    else:
        (tmp_path / "aces.clf.part").write_bytes(LOG + b"x" * (way == "part too long"))
    assert fetch(server, tmp_path).path.read_bytes() == LOG


def test_wrong_bytes_are_refused_and_not_kept(
    server: Server, home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    server.files["aces.clf"] = LOG[:-1] + b"?"
    assert main(["download", "aces", "--from", server.url]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "checksum is wrong" in error
    assert list((home / "freiburg").iterdir()) == []


def test_more_bytes_than_there_are(server: Server, tmp_path: Path) -> None:
    server.files["aces.clf"] = LOG + b"\n" * 100_000
    with pytest.raises(download.RunError, match=f"larger than {len(LOG)} bytes"):
        fetch(server, tmp_path)
    assert leavings(tmp_path) == []


def test_a_file_changed_on_the_disk(server: Server, tmp_path: Path) -> None:
    (tmp_path / "aces.clf").write_bytes(LOG[:1000])
    with pytest.raises(download.DataError, match="remove it"):
        fetch(server, tmp_path)


def test_packed_content_is_held_against_the_same_checksum(server: Server, tmp_path: Path) -> None:
    server.files["aces.clf"] = gzip.compress(LOG)
    assert fetch(server, tmp_path).check == "checksum right"
    (tmp_path / "aces.clf").rename(tmp_path / "aces.clf.gz")
    assert not fetch(server, tmp_path).fetched


def test_an_absent_file(server: Server, home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    del server.files["aces.relations"]
    assert main(["download", "aces", "--from", server.url]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "aces.relations: 404 Not Found" in error
    assert leavings(home / "freiburg") == []


def test_redirects_are_followed_unless_they_have_no_end(server: Server, tmp_path: Path) -> None:
    server.redirects = "/moved/"
    server.cuts = [30_000]
    assert fetch(server, tmp_path).path.read_bytes() == LOG
    server.redirects = "/round/"
    with pytest.raises(download.RunError, match="redirected for ever"):
        fetch(server, tmp_path, remote("aces.relations"))


def test_no_server(tmp_path: Path) -> None:
    with Server() as silent:
        url = silent.url
    with pytest.raises(download.RunError, match="no answer"):
        download.fetch(remote("aces.clf"), tmp_path, lambda *_: None, url)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", CONTENT)
def test_the_first_download_of_an_unknown_content_is_recorded(
    server: Server, tmp_path: Path, name: str
) -> None:
    file = remote(name, known=False)
    first = fetch(server, tmp_path, file)
    sha256 = hashlib.sha256(CONTENT[name]).hexdigest()
    assert first.check == f"unverified, no checksum is known; recorded: sha256 {sha256}"
    assert fetch(server, tmp_path, file).check == "as first downloaded, unverified"
    first.path.write_bytes(CONTENT[name] + b"\n")
    with pytest.raises(download.DataError, match="remove it"):
        fetch(server, tmp_path, file)
    first.path.unlink()
    server.files[name] += b"\n"
    assert "not what was downloaded before" in fetch(server, tmp_path, file).check


@pytest.mark.parametrize("name", CONTENT)
def test_a_page_is_no_log_whatever_is_known(server: Server, tmp_path: Path, name: str) -> None:
    server.files[name] = b"<html><body>Moved, see elsewhere</body></html>\n"
    with pytest.raises(download.RunError, match="not the published file"):
        fetch(server, tmp_path, remote(name, known=False))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["aces", "intel", "mit-csail"])
def test_checksums_are_those_of_the_real_files(
    data_dir: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()
    for file in PUBLISHED[name].files:
        path = published.present(file, data_dir)
        assert path is not None and published.content_sha256(path) == file.sha256
