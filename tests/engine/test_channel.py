"""Whole messages or none, and the files of runs that have ended."""

from __future__ import annotations

import os
import shutil
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.engine import kept
from rbtm_bench.engine.channel import Channel, GarbageError

WORD = b"12345678"


@pytest.fixture
def ends() -> Iterator[tuple[Channel, socket.socket]]:
    ours, theirs = socket.socketpair()
    yield Channel(ours, WORD, plain=True), theirs
    ours.close()
    theirs.close()


def test_messages_come_whole_and_in_order(ends: tuple[Channel, socket.socket]) -> None:
    channel, theirs = ends
    other = Channel(theirs, WORD)
    other.send({"a": [1.5, None]})
    other.send(ConfigError("no such thing"))
    assert channel.receive() == {"a": [1.5, None]}
    assert str(channel.receive(1.0)) == "no such thing"
    with pytest.raises(TimeoutError):
        channel.receive(0.0)
    theirs.sendall(WORD + bytes(3))  # half a message keeps nobody waiting
    with pytest.raises(TimeoutError):
        channel.receive(0.01)
    theirs.close()
    with pytest.raises(EOFError):
        channel.receive(1.0)


def test_what_is_no_message(ends: tuple[Channel, socket.socket]) -> None:
    channel, theirs = ends
    Channel(theirs, WORD).send_bytes(b"no pickle")
    with pytest.raises(GarbageError, match="cannot be read"):
        channel.receive()
    Channel(theirs, WORD).send(Path("code runs when this is read"))
    with pytest.raises(GarbageError, match="cannot be read"):
        channel.receive()
    theirs.sendall(b"1234x")
    with pytest.raises(GarbageError, match="wrote onto the channel"):
        channel.receive()


def test_runs_that_have_ended_are_put_back(tmp_path: Path) -> None:
    for name, status in (("a", "done"), ("b", "failed"), ("c", "started")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "run.json").write_text(f'{{"status": "{status}"}}')
        (tmp_path / name / "trajectory.tum").write_text(name)
    files = kept.of(tmp_path, make=True)
    assert files is not None and kept.of(tmp_path) is files
    files.keep_all()
    assert files.put_back() == []
    before = (tmp_path / "a" / "trajectory.tum").stat()
    (tmp_path / "a" / "trajectory.tum").write_text("z")
    os.utime(tmp_path / "a" / "trajectory.tum", ns=(before.st_atime_ns, before.st_mtime_ns))
    shutil.rmtree(tmp_path / "b")
    (tmp_path / "b").symlink_to(tmp_path / "c")
    (tmp_path / "c" / "trajectory.tum").write_text("z")  # not ended: its own business
    changed = files.put_back()
    assert sorted(changed) == ["a/trajectory.tum", "b/run.json", "b/trajectory.tum"]
    assert [(tmp_path / n / "trajectory.tum").read_text() for n in "abc"] == ["a", "b", "z"]
    assert files.put_back() == []
    del files
    assert kept.of(tmp_path) is None
