"""The pair store: shared by processes that fork and are killed, or a file a worker."""

from __future__ import annotations

import errno
import fcntl
import os
import threading
import time
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
    no_locks,
    outcome,
    sql,
)

from rbtm_bench.pairs import files
from rbtm_bench.pairs import store as pairstore
from rbtm_bench.pairs.store import PairStore, merge

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")  # a note that nobody expects


def test_four_processes_write_and_read_at_once(tmp_path: Path) -> None:
    parts = [range(start, start + 3000) for start in (0, 1000, 2000, 3000)]
    answers = at_once(tmp_path, "shared", parts)
    assert all(not notes for _, notes in answers)
    assert sorted(os.listdir(tmp_path)) == ["pairs.lock", "pairs.sqlite"]  # all closed cleanly
    with PairStore(tmp_path) as store:
        assert known(store, range(6000)) == 6000
        assert store._count() == 6000


def test_one_of_two_processes_sets_a_damaged_store_aside(tmp_path: Path) -> None:
    (tmp_path / "pairs.sqlite").write_bytes(b"no store" * 1000)
    answers = at_once(tmp_path, "shared", [range(500), range(500)])
    assert sorted(len(notes) for _, notes in answers) == [0, 1]
    assert aside(tmp_path) == ["pairs.sqlite.damaged-1"]
    with PairStore(tmp_path) as store:
        assert known(store, range(500)) == 500


def test_readers_do_not_let_the_log_grow(tmp_path: Path) -> None:
    with PairStore(tmp_path) as writer, PairStore(tmp_path) as reader:
        value = outcome(4)
        for i in range(12_000):
            writer.put(i.to_bytes(24), value)
            if i >= 300 and i % 10 == 0:
                assert reader.get((i - 300).to_bytes(24)) is not None
        assert (tmp_path / "pairs.sqlite").stat().st_size > 4e6
        assert (tmp_path / "pairs.sqlite-wal").stat().st_size < 6e6  # SQLite's 1000 pages and more


def test_a_killed_process_loses_at_most_its_last_batch(tmp_path: Path) -> None:
    folder = tmp_path / "pairs"
    total = 0
    with PairStore(folder) as witness:  # one that lives through all of it ...
        for attempt in range(10):
            if attempt == 5:
                witness.close()  # ... half of the time
            starts = [attempt * 10**6, attempt * 10**6 + 500_000]
            writers = killed_writers(folder, starts, "shared", tmp_path / f"log{attempt}")
            with PairStore(folder) as store:
                for start, (put, committed) in zip(starts, writers, strict=True):
                    assert known(store, range(start, committed)) == committed - start
                    # the last put may have been written without a word of it
                    stored = known(store, range(start, put + BATCH + 1))
                    assert stored >= put - start - BATCH
                    total += stored
                new = range(10**8 + attempt, 10**8 + attempt + 1)
                fill(store, new)
                store.flush()
                assert known(store, new) == 1
            assert not store.notes
    assert total > 10 * BATCH
    assert aside(folder) == []


def in_a_child(action: Callable[[], bool]) -> Callable[[], bool]:
    """Fork; the answer waits for the child and says whether its action came out true."""
    pid = os.fork()
    if pid == 0:
        good = False
        try:
            good = action()
        finally:
            os._exit(0 if good else 1)
    return lambda: os.waitpid(pid, 0)[1] == 0


@pytest.mark.parametrize("mode", ["shared", "per_worker"])
def test_a_fork_is_noticed(tmp_path: Path, mode: Any) -> None:
    make(tmp_path)
    store = PairStore(tmp_path, mode)
    fill(store, range(2000, 2010))
    store.flush()
    fill(store, range(3000, 3010))  # pending
    closed, go_on = os.pipe()

    def child() -> bool:
        stored = known(store, range(1000)) == 1000
        pending = known(store, range(3000, 3010))
        fill(store, range(4000, 4010))
        os.read(closed, 1)
        store.close()
        return stored and pending == 0

    done = in_a_child(child)
    time.sleep(0.2)
    assert known(store, range(2000, 3010)) == 20
    store.close()  # with SQLite's inherited locks, the child would now write into nothing
    os.write(go_on, b"x")
    assert done()
    assert merge(tmp_path) == 1030
    with PairStore(tmp_path) as store:
        assert known(store, range(5000)) == 1030


def test_a_fork_from_another_thread(tmp_path: Path) -> None:
    """The files of a thread cannot be closed by another: the child does without the store."""
    make(tmp_path)
    stores: list[PairStore] = []
    forked, checked = threading.Event(), threading.Event()

    def own() -> None:
        stores.append(PairStore(tmp_path))
        forked.set()
        checked.wait()
        assert known(stores[0], range(1000)) == 1000
        stores[0].close()

    thread = threading.Thread(target=own)
    thread.start()
    forked.wait()

    def child() -> bool:
        with pytest.warns(RuntimeWarning, match="forked"):
            store = stores[0]
            store.put(key(2000), outcome(2000))
            return store.get(key(1)) is None

    assert in_a_child(child)()
    checked.set()
    thread.join()
    with PairStore(tmp_path) as store:
        assert known(store, range(3000)) == 1000


def test_a_child_that_only_closes(tmp_path: Path) -> None:
    with PairStore(tmp_path) as store:
        fill(store, range(10))

        def child() -> bool:
            store.close()
            return True

        assert in_a_child(child)()
        assert known(store, range(10)) == 10
    with PairStore(tmp_path) as store:
        assert known(store, range(10)) == 10


def test_workers_read_what_others_have_closed(tmp_path: Path) -> None:
    one, other = PairStore(tmp_path, "per_worker"), PairStore(tmp_path, "per_worker")
    fill(one, range(10))
    fill(other, range(10, 20))
    one.flush()
    other.flush()
    assert len(list(tmp_path.glob("*.sqlite.open"))) == 2
    assert not list(tmp_path.glob("*.sqlite"))
    assert known(one, range(20)) == 10
    one.close()
    other._rescan = 0.0
    other.flush()
    assert known(other, range(20)) == 20
    other.close()
    assert all(name.endswith(".sqlite") for name in os.listdir(tmp_path))
    with PairStore(tmp_path, "per_worker") as third:
        assert known(third, range(20)) == 20
    assert len(os.listdir(tmp_path)) == 2  # the third had nothing to write

    assert merge(tmp_path) == 20
    assert sorted(os.listdir(tmp_path)) == ["pairs.lock", "pairs.sqlite"]
    with PairStore(tmp_path) as store:
        assert known(store, range(20)) == 20
        with PairStore(tmp_path, "per_worker") as fourth:
            assert known(fourth, range(20)) == 0  # not while somebody writes it
    with PairStore(tmp_path, "per_worker") as fourth:
        assert known(fourth, range(20)) == 20
    assert merge(tmp_path) == 20


def test_four_workers_and_a_merge(tmp_path: Path) -> None:
    parts = [range(start, start + 1000) for start in (0, 0, 500, 1000)]
    answers = at_once(tmp_path, "per_worker", parts)
    assert all(not notes for _, notes in answers)
    assert merge(tmp_path) == 2000
    with PairStore(tmp_path) as store:
        assert known(store, range(2000)) == 2000


def test_merge_takes_the_files_of_killed_workers(tmp_path: Path) -> None:
    folder = tmp_path / "pairs"
    total = 0
    for attempt in range(2):
        starts = [attempt * 10**6, attempt * 10**6 + 500_000]
        writers = killed_writers(folder, starts, "per_worker", tmp_path / f"log{attempt}")
        assert len(list(folder.glob("*.open"))) <= 2  # one may not have got that far
        total = merge(folder)
        assert sorted(os.listdir(folder)) == ["pairs.lock", "pairs.sqlite"]
        with PairStore(folder) as store:
            for start, (put, committed) in zip(starts, writers, strict=True):
                assert known(store, range(start, committed)) == committed - start
                assert known(store, range(start, put)) >= put - start - BATCH
    assert total > 0


def test_what_was_being_made_by_a_killed_process_goes(tmp_path: Path) -> None:
    (tmp_path / ".1.partial.pairs.sqlite").write_bytes(b"")
    (tmp_path / ".1.partial.pairs-host-1-ab.sqlite.open-journal").write_bytes(b"")
    assert merge(tmp_path) == 0
    assert sorted(os.listdir(tmp_path)) == ["pairs.lock", "pairs.sqlite"]


def test_merge_leaves_living_workers_alone(tmp_path: Path) -> None:
    with PairStore(tmp_path, "per_worker") as store:
        fill(store, range(10))
        store.flush()
        assert merge(tmp_path) == 0
        assert known(store, range(10)) == 10
    assert merge(tmp_path) == 10


def test_merge_sets_damaged_files_aside(tmp_path: Path) -> None:
    for part in (range(10), range(10, 20), range(20, 30), range(30, 40)):
        with PairStore(tmp_path, "per_worker") as store:
            fill(store, part)
    first, second, third, _ = files.sealed_files(tmp_path)
    first.write_bytes(b"no store")
    sql(second, "UPDATE pairs SET value = x'00'")
    os.truncate(third, 4096)
    with pytest.warns(RuntimeWarning, match="not to be trusted"):
        assert merge(tmp_path) == 10
    assert len(aside(tmp_path)) == 3
    assert files.sealed_files(tmp_path) == []


def test_a_worker_sets_damaged_files_aside(tmp_path: Path) -> None:
    for part in (range(10), range(10, 20), range(20, 30)):
        with PairStore(tmp_path, "per_worker") as store:
            fill(store, part)
    first, second, _ = files.sealed_files(tmp_path)
    first.write_bytes(b"no store")
    sql(second, "UPDATE pairs SET value = x'00'")
    with pytest.warns(RuntimeWarning), PairStore(tmp_path, "per_worker") as store:
        assert known(store, range(30)) == 10
        assert len(store.notes) == 2
        fill(store, range(30, 40))
        store.flush()
        assert store._own is not None
        store._own.db.execute("UPDATE pairs SET value = x'00'")
        assert known(store, range(30, 40)) == 0
        fill(store, range(30, 35))
    assert len(aside(tmp_path)) == 3
    assert merge(tmp_path) == 15


def test_merge_without_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make(tmp_path, 10)  # once made where locks work
    monkeypatch.setattr(fcntl, "flock", no_locks)
    with PairStore(tmp_path, "per_worker") as store:
        assert known(store, range(20)) == 10
        fill(store, range(10, 20))
    assert merge(tmp_path) == 20
    with PairStore(tmp_path, "per_worker") as store:
        assert known(store, range(20)) == 20
    monkeypatch.undo()
    with PairStore(tmp_path) as store:
        assert known(store, range(20)) == 20


def test_merge_keeps_what_it_cannot_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with PairStore(tmp_path, "per_worker") as store:
        fill(store, range(10))

    def full(db: object, rows: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(pairstore, "insert", full)
    with pytest.warns(RuntimeWarning, match="No space"):
        assert merge(tmp_path) == 0
    monkeypatch.undo()
    assert merge(tmp_path) == 10
