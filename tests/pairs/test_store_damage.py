"""The pair store with damaged files, on full disks, without rights or locks: never fatal."""

from __future__ import annotations

import os
import random
import sqlite3
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pairstore_helpers import (
    BATCH,
    aside,
    at_once,
    fill,
    key,
    killed_writers,
    known,
    make,
    outcome,
    overwrite,
    sql,
)

from rbtm_bench.pairs import store as pairstore
from rbtm_bench.pairs.codec import FORMAT, pack
from rbtm_bench.pairs.store import PairStore


def copy_of_another(path: Path) -> None:
    path.unlink()
    sql(path, "CREATE TABLE guests (name TEXT)", "INSERT INTO guests VALUES ('Besl')")


DAMAGES: dict[str, Callable[[Path], object]] = {
    "no database": lambda path: path.write_bytes(b"not a database, " * 1000),
    "another program's": copy_of_another,
    "an earlier version's": lambda path: sql(path, f"PRAGMA user_version={FORMAT - 1}"),
    "first page": lambda path: os.truncate(path, 4096),
    "header only": lambda path: os.truncate(path, 100),
    "another column": lambda path: sql(path, "ALTER TABLE pairs ADD COLUMN x"),
    "one more table": lambda path: sql(path, "CREATE TABLE x (y)"),
    "root of the tree": lambda path: overwrite(path, 4096, bytes(4096)),
    "schema": lambda path: overwrite(path, 100, os.urandom(3996)),
    "text in the schema": lambda path: overwrite(path, 4060, b"\x80" * 36),
}
UNSEEN: dict[str, Callable[[Path], object]] = {
    "empty": lambda path: path.write_bytes(b""),
    "no table": lambda path: sql(path, "DROP TABLE pairs"),
}
"""What is no more than a store without pairs."""


@pytest.mark.parametrize("damage", [*DAMAGES, *UNSEEN])
def test_a_damaged_file_is_set_aside(
    tmp_path: Path, damage: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = make(tmp_path)
    (DAMAGES | UNSEEN)[damage](path)
    content = path.read_bytes()
    with PairStore(tmp_path) as store:
        assert known(store, range(1000)) == 0
        fill(store, range(100))
    with PairStore(tmp_path) as store:
        assert known(store, range(1000)) == 100
    said = capsys.readouterr().err
    if damage in UNSEEN:
        assert said == "" and aside(tmp_path) == []
        return
    assert said.startswith(f"rbtm-bench: {path} is not used (") and said.count("\n") == 1
    assert said.endswith("set aside as pairs.sqlite.damaged-1\n")
    assert (tmp_path / "pairs.sqlite.damaged-1").read_bytes() == content
    DAMAGES[damage](path)
    with PairStore(tmp_path) as store:
        known(store, range(100))
    assert aside(tmp_path) == ["pairs.sqlite.damaged-1", "pairs.sqlite.damaged-2"]


def test_two_processes_begin_a_damaged_store_anew(tmp_path: Path) -> None:
    (tmp_path / "pairs.sqlite").write_bytes(b"no store" * 1000)
    at_once(tmp_path, "shared", [range(500), range(500)])
    assert "pairs.sqlite.damaged-1" in aside(tmp_path)
    with PairStore(tmp_path) as store:
        assert known(store, range(500)) == 500


BLOB = pack(key(500), outcome(500))
WRONG_VALUES = {
    "one bit": f"x'{(BLOB[:-1] + bytes([BLOB[-1] ^ 1])).hex()}'",
    "short": f"x'{BLOB[:-1].hex()}'",
    "nothing": "x''",
    "text": "'converged'",
    "number": "3.0",
    "of another pair": "(SELECT value FROM pairs ORDER BY key LIMIT 1)",
}


@pytest.mark.parametrize("change", WRONG_VALUES)
def test_a_wrong_value_is_computed_again(
    tmp_path: Path, change: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = make(tmp_path)
    sql(path, f"UPDATE pairs SET value = {WRONG_VALUES[change]} WHERE key = x'{key(500).hex()}'")
    with PairStore(tmp_path) as store:
        assert known(store, range(1000)) == 999
        assert store.get(key(500)) is None
        fill(store, range(500, 501))
    with PairStore(tmp_path) as store:
        assert known(store, range(1000)) == 1000
    assert aside(tmp_path) == []
    assert capsys.readouterr().err.count("does not fit its checksum") == 1


def test_a_store_damaged_while_in_use_is_begun_anew(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = make(tmp_path, 3000)
    with PairStore(tmp_path) as store, PairStore(tmp_path) as other:
        fill(store, range(5000, 5010))  # pending
        overwrite(path, 4096, os.urandom(path.stat().st_size - 4096))
        assert known(store, range(3000)) == 0
        fill(store, range(100))
        store.flush()
        fill(other, range(100, 200))
        other.flush()
        assert known(store, range(200)) == 200 and known(other, range(200)) == 200
    with PairStore(tmp_path) as store:
        assert known(store, range(6000)) == 210
    assert aside(tmp_path) == ["pairs.sqlite.damaged-1"]
    assert capsys.readouterr().err.count("set aside") == 1


def test_too_much_damage_ends_the_store(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with PairStore(tmp_path, batch=1) as store:
        for _ in range(9):
            fill(store, range(300))
            path = tmp_path / "pairs.sqlite"
            if path.exists():
                sql(path, "PRAGMA wal_checkpoint(TRUNCATE)")
                overwrite(path, 4096, os.urandom(path.stat().st_size - 4096))
            known(store, range(300))
    assert "neither read nor kept" in capsys.readouterr().err
    assert len(aside(tmp_path)) == 3


def test_a_store_deleted_while_in_use_is_made_anew(tmp_path: Path) -> None:
    with PairStore(tmp_path / "pairs") as store:
        fill(store, range(10))
        store.flush()
        for path in (tmp_path / "pairs").iterdir():
            path.unlink()
        (tmp_path / "pairs").rmdir()
        fill(store, range(10, 20))
        store.flush()
        with PairStore(tmp_path / "pairs") as other:
            assert known(other, range(20)) == 10


# --- mutants: bytes changed at rest


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The files of a store of 300 pairs whose last writer was killed: half of them in the log."""
    folder = tmp_path_factory.mktemp("pairs")
    make(folder, 150)
    with PairStore(folder) as store:
        fill(store, range(150, 300))
        store.flush()
        return {path.name: path.read_bytes() for path in folder.iterdir()}


def mutant(content: bytes, rng: random.Random) -> bytes:
    """A file with bytes changed, a piece of noise, of zeros or of itself, or cut off."""
    data, size = bytearray(content), len(content)
    near_the_start = rng.random() < 0.3
    at = rng.randrange(200 if near_the_start else size)
    length = rng.choice([1, 16, 512, 4096])
    how = rng.randrange(6)
    if how < 2:
        for _ in range(rng.randint(1, 30)):
            data[rng.randrange(size)] = rng.randrange(256)
    elif how == 2:
        data[at : at + length] = rng.randbytes(length)[: size - at]
    elif how == 3:
        data[at : at + length] = bytes(length)[: size - at]
    elif how == 4:
        page, other = (4096 * rng.randrange(max(1, size // 4096)) for _ in range(2))
        data[page : page + 4096] = data[other : other + 4096]
    else:
        del data[at:]
    return bytes(data)


@pytest.mark.parametrize("seed", range(10))
def test_no_mutant_gives_a_wrong_value(tmp_path: Path, sound: dict[str, bytes], seed: int) -> None:
    """Of 200: a right value, or none, and no error; what is put then comes back as well."""
    assert set(sound) == {"pairs.sqlite", "pairs.sqlite-wal", "pairs.sqlite-shm"}
    there = 0
    for number in range(20):
        rng = random.Random(100 * seed + number)
        folder = tmp_path / str(number)
        folder.mkdir()
        changed = rng.choice(["pairs.sqlite", "pairs.sqlite", "pairs.sqlite-wal"])
        for name, content in sound.items():
            (folder / name).write_bytes(mutant(content, rng) if name == changed else content)
        with PairStore(folder) as store:
            there += known(store, range(300))
            fill(store, range(300, 310))
            store.flush()
            known(store, range(310))
        with PairStore(folder) as store:
            known(store, range(310))
            fill(store, range(310))
        with PairStore(folder, "per_worker") as store:
            known(store, range(310))
    assert 0 < there < 20 * 300


def test_a_damaged_log_is_harmless(tmp_path: Path) -> None:
    writers = killed_writers(tmp_path / "pairs", [0], "shared", tmp_path / "log", BATCH + 1)
    log = tmp_path / "pairs" / "pairs.sqlite-wal"
    overwrite(log, log.stat().st_size // 2, os.urandom(100))
    with PairStore(tmp_path / "pairs") as store:
        assert known(store, range(writers[0][0])) < writers[0][0]
        fill(store, range(100))
    with PairStore(tmp_path / "pairs") as store:
        # SQLite does not look at a log again whose index is still there: a page may stay damaged,
        # which costs the pairs on it, never a value
        assert known(store, range(100)) >= 100 - BATCH


def test_a_log_left_behind_does_no_harm_to_a_new_store(tmp_path: Path) -> None:
    killed_writers(tmp_path / "pairs", [0], "shared", tmp_path / "log")
    (tmp_path / "pairs" / "pairs.sqlite").unlink()
    with PairStore(tmp_path / "pairs") as store:
        known(store, range(100))
        fill(store, range(100))
    with PairStore(tmp_path / "pairs") as store:
        assert known(store, range(100)) == 100


# --- disks, rights, locks


def given_up(store: PairStore, said: str, why: str = "") -> None:
    assert said.count("\n") == 1 and why in said
    assert "pairs are neither read nor kept from now on" in said
    fill(store, range(1000))
    store.flush()
    assert known(store, range(1000)) == 0
    store.close()
    store.close()
    assert store.get(key(1)) is None


def test_a_full_disk_ends_the_store_not_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    make(tmp_path, 100)
    connect = sqlite3.connect

    def small(*arguments: Any, **options: Any) -> sqlite3.Connection:
        db = connect(*arguments, **options)
        db.execute("PRAGMA max_page_count=20")
        return db

    monkeypatch.setattr(pairstore.sqlite3, "connect", small)
    store = PairStore(tmp_path)
    fill(store, range(1000, 2000))
    given_up(store, capsys.readouterr().err, "full")
    with PairStore(tmp_path) as store:
        assert known(store, range(100)) == 100


@pytest.mark.parametrize("mode", ["shared", "per_worker"])
def test_a_file_system_that_runs_full(
    tmp_path: Path, mode: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["mount", "-t", "tmpfs", "-o", "size=512k", "tmpfs", str(tmp_path)]
    if os.geteuid() != 0 or subprocess.run(command, capture_output=True).returncode:
        pytest.skip("only root can mount a small file system")
    try:
        store = PairStore(tmp_path, mode)
        fill(store, range(5000))
        given_up(store, capsys.readouterr().err)
        with PairStore(tmp_path, mode) as store:
            known(store, range(5000))
    finally:
        subprocess.run(["umount", "-l", str(tmp_path)], check=True)


@pytest.mark.parametrize("filled", [False, True])
@pytest.mark.parametrize("mode", ["shared", "per_worker"])
def test_a_folder_that_cannot_be_written(
    filled: bool, mode: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if filled:
            make(folder)
        folder.chmod(0o555)
        root = os.geteuid() == 0
        if root:
            os.seteuid(65534)  # root may write anywhere
        try:
            store = PairStore(folder, mode)
            store.put(key(-1), outcome(1))
            store.flush()
            given_up(store, capsys.readouterr().err)
        finally:
            if root:
                os.seteuid(0)
            folder.chmod(0o755)
        assert aside(folder) == []


def test_a_file_in_the_folders_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "pairs").write_text("a file")
    store = PairStore(tmp_path / "pairs")
    given_up(store, capsys.readouterr().err)


def test_a_writer_that_never_ends(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also what is said where a file system has no locks: another mode is named."""
    path = make(tmp_path, 10)
    monkeypatch.setattr(pairstore, "_WAIT", 0.05)
    stuck = sqlite3.connect(path, isolation_level=None)
    stuck.execute("BEGIN IMMEDIATE")
    store = PairStore(tmp_path)
    fill(store, range(300))
    given_up(store, capsys.readouterr().err, "locked (pairs.store=per_worker needs no locks)")
    stuck.execute("ROLLBACK")
    stuck.close()
