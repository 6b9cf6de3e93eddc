"""Files appear whole or not at all."""

from __future__ import annotations

import json
import math
import os
import pickle
import threading
from pathlib import Path

import pytest

from rbtm_bench.core.errors import ConfigError, WriteError
from rbtm_bench.core.files import make_folder, write_atomically, write_json, write_text


def test_a_written_file_is_there_and_alone(tmp_path: Path) -> None:
    write_text(tmp_path / "a.txt", "Grüße\n")
    assert (tmp_path / "a.txt").read_bytes() == "Grüße\n".encode()
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_a_write_that_fails_leaves_nothing(tmp_path: Path) -> None:
    def half(path: Path) -> None:
        path.write_text("half a")
        raise OSError("No space left on device")

    with pytest.raises(WriteError, match=r"/a\.txt: cannot be written: No space"):
        write_atomically(tmp_path / "a.txt", half)
    assert list(tmp_path.iterdir()) == []


def test_a_write_error_names_the_file_everywhere(tmp_path: Path) -> None:
    with pytest.raises(WriteError) as caught:
        write_text(tmp_path / "no" / "a.txt", "a")
    error = pickle.loads(pickle.dumps(caught.value))  # from a run's process to its parent
    assert (
        str(error) == f"{tmp_path / 'no' / 'a.txt'}: cannot be written: No such file or directory"
    )
    assert isinstance(error, OSError) and (error.errno, error.exit_code) == (2, 1)


def test_a_write_that_fails_leaves_the_earlier_file(tmp_path: Path) -> None:
    write_text(tmp_path / "a.json", "1\n")
    with pytest.raises(ValueError):
        write_json(tmp_path / "a.json", {"error": math.nan})
    with pytest.raises(TypeError):
        write_json(tmp_path / "a.json", {"path": tmp_path})
    with pytest.raises(KeyboardInterrupt):
        write_atomically(tmp_path / "a.json", lambda path: interrupt(path))
    assert (tmp_path / "a.json").read_text() == "1\n"
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def interrupt(path: Path) -> None:
    path.write_text("half a")
    raise KeyboardInterrupt


def test_the_temporary_file_is_beside_the_target_and_keeps_its_ending(tmp_path: Path) -> None:
    seen: list[Path] = []

    def write(path: Path) -> None:
        seen.append(path)
        path.write_text("x")

    write_atomically(tmp_path / "map.npz", write)
    assert seen[0].parent == tmp_path and seen[0].suffix == ".npz"
    assert seen[0].name.startswith(".") and str(os.getpid()) in seen[0].name


def test_a_reader_never_sees_half_a_file(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    value = {"numbers": list(range(2000))}
    write_json(path, value)
    stop = threading.Event()

    def keep_writing() -> None:
        while not stop.is_set():
            write_json(path, value)

    writer = threading.Thread(target=keep_writing)
    writer.start()
    try:
        assert all(json.loads(path.read_text()) == value for _ in range(200))
    finally:
        stop.set()
        writer.join()


def test_json_keeps_every_digit(tmp_path: Path) -> None:
    values = [0.1 + 0.2, 1e-300, 1 / 3, 12345678901234567]
    write_json(tmp_path / "a.json", values)
    assert json.loads((tmp_path / "a.json").read_text()) == values


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    make_folder(tmp_path / "a" / "b")
    make_folder(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir()
    (tmp_path / "file").touch()
    for out in (tmp_path / "file", tmp_path / "file" / "below", tmp_path / ("x" * 300)):
        with pytest.raises(ConfigError) as caught:
            make_folder(out)
        assert str(caught.value).startswith(f"out={out}: cannot be made: ")
