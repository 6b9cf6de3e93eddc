"""The pair store with damaged files, on full disks, without rights or locks: never fatal."""

from __future__ import annotations

import fcntl
import os
import subprocess
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pairstore_helpers import (
    BATCH,
    aside,
    fill,
    key,
    killed_writers,
    known,
    make,
    no_locks,
    outcome,
    overwrite,
    sql,
)

from rbtm_bench.pairs import files
from rbtm_bench.pairs.codec import FORMAT, pack
from rbtm_bench.pairs.store import PairStore

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")  # a note that nobody expects


def copy_of_another(path: Path) -> None:
    path.unlink()
    sql(path, "CREATE TABLE guests (name TEXT)", "INSERT INTO guests VALUES ('Besl')")


DAMAGES: dict[str, Callable[[Path], object]] = {
    "no database": lambda path: path.write_bytes(b"not a database, " * 1000),
    "empty": lambda path: path.write_bytes(b""),
    "another program's": copy_of_another,
    "another application": lambda path: sql(path, "PRAGMA application_id=7"),
    "another version": lambda path: sql(path, f"PRAGMA user_version={FORMAT + 1}"),
    "half of it": lambda path: os.truncate(path, path.stat().st_size // 2),
    "first page": lambda path: os.truncate(path, 4096),
    "header only": lambda path: os.truncate(path, 100),
    "another column": lambda path: sql(path, "ALTER TABLE pairs ADD COLUMN x"),
    "no table": lambda path: sql(path, "DROP TABLE pairs"),
    "one more table": lambda path: sql(path, "CREATE TABLE x (y)"),
    "pages of noise": lambda path: overwrite(path, 3 * 4096, os.urandom(3 * 4096)),
    "root of the tree": lambda path: overwrite(path, 4096, bytes(4096)),
    "schema": lambda path: overwrite(path, 100, os.urandom(3996)),
    "text in the schema": lambda path: overwrite(path, 4060, b"\x80" * 36),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_set_aside(tmp_path: Path, damage: str) -> None:
    path = make(tmp_path)
    DAMAGES[damage](path)
    content = path.read_bytes()
    with (
        pytest.warns(RuntimeWarning, match=r"pairs\.sqlite is not to be trusted"),
        PairStore(tmp_path) as store,
    ):
        assert len(store.notes) == 1
        assert "pairs.sqlite.damaged-1" in store.notes[0]
        assert known(store, range(1000)) == 0
        fill(store, range(100))
    assert (tmp_path / "pairs.sqlite.damaged-1").read_bytes() == content
    with PairStore(tmp_path) as store:
        assert known(store, range(1000)) == 100
    DAMAGES[damage](path)
    with pytest.warns(RuntimeWarning), PairStore(tmp_path):
        assert aside(tmp_path) == ["pairs.sqlite.damaged-1", "pairs.sqlite.damaged-2"]


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
def test_a_wrong_value_is_never_handed_out(tmp_path: Path, change: str) -> None:
    path = make(tmp_path)
    sql(path, f"UPDATE pairs SET value = {WRONG_VALUES[change]} WHERE key = x'{key(500).hex()}'")
    with PairStore(tmp_path) as store:
        assert known(store, range(500)) == 500
        fill(store, range(2000, 2010))  # pending, not lost
        with pytest.warns(RuntimeWarning, match="checksum"):
            assert store.get(key(500)) is None
        assert known(store, range(1000)) == 0
        fill(store, range(500, 510))
        assert known(store, range(500, 510)) == 10
    assert aside(tmp_path) == ["pairs.sqlite.damaged-1"]
    with PairStore(tmp_path) as store:
        assert known(store, range(3000)) == 20


def test_others_go_on_in_the_new_store(tmp_path: Path) -> None:
    path = make(tmp_path)
    sql(path, f"UPDATE pairs SET value = x'00' WHERE key = x'{key(1).hex()}'")
    with PairStore(tmp_path) as one, PairStore(tmp_path) as other:
        assert known(other, range(10, 20)) == 10
        fill(other, range(2000, 2010))
        with pytest.warns(RuntimeWarning, match="checksum"):
            assert one.get(key(1)) is None
        other.flush()
        assert known(one, range(2000, 2010)) == 10
        assert other.notes == []
    assert aside(tmp_path) == ["pairs.sqlite.damaged-1"]
    assert sorted(os.listdir(tmp_path))[:2] == ["pairs.lock", "pairs.sqlite"]
    with PairStore(tmp_path) as store:
        assert known(store, range(3000)) == 10


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


def test_a_store_damaged_while_in_use_is_set_aside(tmp_path: Path) -> None:
    path = make(tmp_path, 3000)
    with PairStore(tmp_path) as store:
        overwrite(path, 4096, os.urandom(path.stat().st_size - 4096))
        with pytest.warns(RuntimeWarning, match="not to be trusted"):
            assert known(store, range(3000)) == 0
        fill(store, range(100))
    with PairStore(tmp_path) as store:
        assert known(store, range(100)) == 100


def test_too_much_damage_ends_the_store(tmp_path: Path) -> None:
    with PairStore(tmp_path, batch=1) as store:
        with pytest.warns(RuntimeWarning):
            for _ in range(9):
                fill(store, range(2))
                if store._own:
                    store._own.db.execute("UPDATE pairs SET value = x'00'")
                assert known(store, range(2)) == 0
        assert "neither" in store.notes[-1]
    assert len(aside(tmp_path)) == 3


@pytest.fixture(scope="module")
def small_store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make(tmp_path_factory.mktemp("pairs"), 200)


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_damage_anywhere_is_harmless(
    tmp_path_factory: Any, small_store: Path, data: st.DataObject
) -> None:
    """Bytes changed at rest, unnoticed at opening: a right value, or none, and no error."""
    folder = tmp_path_factory.mktemp("fuzz")
    path = folder / "pairs.sqlite"
    path.write_bytes(small_store.read_bytes())
    stat = path.stat()
    (folder / "pairs.lock").write_text(files.stamp(path))
    near_the_start = st.integers(0, 150) | st.integers(4096, 4300)
    for _ in range(data.draw(st.integers(1, 30))):
        at = data.draw(near_the_start | st.integers(0, stat.st_size - 1))
        overwrite(path, at, bytes([data.draw(st.integers(0, 255))]))
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    with (
        pytest.warns(RuntimeWarning, match="trusted|neither|made up"),
        PairStore(folder) as store,
    ):
        warnings.warn("made up", RuntimeWarning, stacklevel=1)  # the damage may not show
        known(store, range(200))
        fill(store, range(200, 210))
        store.flush()
        known(store, range(210))


def test_a_damaged_log_is_harmless(tmp_path: Path) -> None:
    writers = killed_writers(tmp_path / "pairs", [0], "shared", tmp_path / "log", BATCH + 1)
    log = tmp_path / "pairs" / "pairs.sqlite-wal"
    overwrite(log, log.stat().st_size // 2, os.urandom(100))
    with PairStore(tmp_path / "pairs") as store:
        assert known(store, range(writers[0][0])) < writers[0][0]
        fill(store, range(100))
    with PairStore(tmp_path / "pairs") as store:
        assert known(store, range(100)) == 100


def test_a_log_left_behind_does_not_get_into_a_new_store(tmp_path: Path) -> None:
    killed_writers(tmp_path / "pairs", [0], "shared", tmp_path / "log")
    (tmp_path / "pairs" / "pairs.sqlite").unlink()
    with PairStore(tmp_path / "pairs") as store:
        assert known(store, range(100)) == 0


def test_pages_are_looked_through_only_after_an_unclean_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks: list[int] = []
    monkeypatch.setattr(files, "check_pages", lambda db: looks.append(1))
    path = make(tmp_path)
    with PairStore(tmp_path), PairStore(tmp_path):
        pass
    assert not looks
    os.utime(path)  # changed by somebody else
    with PairStore(tmp_path) as first:
        assert len(looks) == 1
        fill(first, range(2000, 4000))
        with PairStore(tmp_path):  # the first has looked
            assert len(looks) == 1
    with PairStore(tmp_path):
        assert len(looks) == 1
    (tmp_path / "pairs.lock").write_bytes(os.urandom(50))
    with PairStore(tmp_path):
        assert len(looks) == 2


def given_up(store: PairStore, why: str) -> None:
    assert len(store.notes) == 1
    assert "neither looked up nor kept" in store.notes[0]
    assert why in store.notes[0]
    fill(store, range(1000))
    store.flush()
    assert known(store, range(1000)) == 0
    store.close()
    store.close()
    assert store.get(key(1)) is None


def test_a_full_disk_ends_the_store_not_the_run(tmp_path: Path) -> None:
    make(tmp_path, 100)
    store = PairStore(tmp_path)
    assert store._own is not None
    store._own.db.execute("PRAGMA max_page_count=20")
    with pytest.warns(RuntimeWarning, match="full"):
        fill(store, range(1000, 2000))
    given_up(store, "full")
    with PairStore(tmp_path) as store:
        assert known(store, range(100)) == 100


@pytest.mark.parametrize("mode", ["shared", "per_worker"])
def test_a_file_system_that_runs_full(tmp_path: Path, mode: Any) -> None:
    command = ["mount", "-t", "tmpfs", "-o", "size=512k", "tmpfs", str(tmp_path)]
    if os.geteuid() != 0 or subprocess.run(command, capture_output=True).returncode:
        pytest.skip("only root can mount a small file system")
    try:
        store = PairStore(tmp_path, mode)
        with pytest.warns(RuntimeWarning, match="neither"):
            fill(store, range(5000))
        given_up(store, "")
        (tmp_path / "ballast").write_bytes(b"")
        with PairStore(tmp_path, mode) as store:
            known(store, range(5000))
    finally:
        subprocess.run(["umount", "-l", str(tmp_path)], check=True)


@pytest.mark.parametrize("filled", [False, True])
@pytest.mark.parametrize("mode", ["shared", "per_worker"])
def test_a_folder_that_cannot_be_written(filled: bool, mode: Any) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if filled:
            make(folder)
        folder.chmod(0o555)
        root = os.geteuid() == 0
        if root:
            os.seteuid(65534)  # root may write anywhere
        try:
            with pytest.warns(RuntimeWarning, match="neither"):
                store = PairStore(folder, mode)
                store.put(key(-1), outcome(1))
                store.flush()
            given_up(store, "")
        finally:
            if root:
                os.seteuid(0)
            folder.chmod(0o755)
        assert aside(folder) == []


def test_a_file_in_the_folders_place(tmp_path: Path) -> None:
    (tmp_path / "pairs").write_text("a file")
    with pytest.warns(RuntimeWarning, match="neither"):
        store = PairStore(tmp_path / "pairs")
    given_up(store, "")


def test_without_locks_another_mode_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fcntl, "flock", no_locks)
    with pytest.warns(RuntimeWarning, match="per_worker"):
        store = PairStore(tmp_path)
    given_up(store, "cannot be locked")


def test_a_lock_that_is_never_released(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "_WAIT", 0.05)
    with files.locked(tmp_path), pytest.warns(RuntimeWarning, match="has been locked"):
        store = PairStore(tmp_path)
    given_up(store, "locked")


def test_a_writer_that_never_ends(tmp_path: Path) -> None:
    with PairStore(tmp_path) as stuck, PairStore(tmp_path) as store:
        assert stuck._own is not None and store._own is not None
        stuck._own.db.execute("BEGIN IMMEDIATE")
        store._own.db.execute("PRAGMA busy_timeout=50")
        with pytest.warns(RuntimeWarning, match="locked"):
            fill(store, range(300))
        given_up(store, "locked")
        stuck._own.db.execute("ROLLBACK")
