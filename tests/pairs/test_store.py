"""The pair store: shared by processes that fork and are killed, or a file a worker."""

from __future__ import annotations

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
    outcome,
    overwrite,
    sql,
)

from rbtm_bench.core.types import RegistrationResult
from rbtm_bench.pairs.store import PairStore, merge


@pytest.fixture(autouse=True)
def silence(capfd: pytest.CaptureFixture[str]) -> Any:
    """Nothing is said that a test does not read."""
    yield
    assert capfd.readouterr().err == ""


def stored(folder: Path) -> int:
    """What a new process sees of the first 10,000 pairs."""
    with PairStore(folder) as store:
        return known(store, range(10_000))


# --- one process, and several


def test_what_comes_back_says_that_it_is_not_new(tmp_path: Path) -> None:
    with PairStore(tmp_path) as store:
        store.put(key(1), outcome(1))
        for _ in ("pending", "written"):
            known = store.get(key(1))
            assert isinstance(known, RegistrationResult) and known.reused
            store.flush()


def test_pending_pairs_are_seen_by_others_when_they_are_written(tmp_path: Path) -> None:
    with PairStore(tmp_path, batch=10, seconds=100) as store, PairStore(tmp_path) as other:
        fill(store, range(9))
        assert (known(store, range(20)), known(other, range(20))) == (9, 0)
        fill(store, range(9, 11))
        assert (known(store, range(20)), known(other, range(20))) == (11, 10)
        store.flush()
        assert known(other, range(20)) == 11


def test_pending_pairs_are_written_after_a_time(tmp_path: Path) -> None:
    with PairStore(tmp_path, seconds=0.05) as store, PairStore(tmp_path) as other:
        fill(store, range(1))
        assert known(other, range(2)) == 0
        time.sleep(0.06)
        fill(store, range(1, 2))
        assert known(other, range(2)) == 2


def test_four_processes_write_and_read_at_once(tmp_path: Path) -> None:
    at_once(tmp_path, "shared", [range(start, start + 3000) for start in (0, 1000, 2000, 3000)])
    assert os.listdir(tmp_path) == ["pairs.sqlite"]  # all closed cleanly
    assert stored(tmp_path) == 6000


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
                    there = known(store, range(start, put + BATCH + 1))
                    assert there >= put - start - BATCH
                    total += there
                new = range(10**8 + attempt, 10**8 + attempt + 1)
                fill(store, new)
                store.flush()
                assert known(store, new) == 1
    assert total > 10 * BATCH
    assert aside(folder) == []


# --- forks


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
    looked, tell = os.pipe()
    closed, go_on = os.pipe()

    def child() -> bool:
        there = known(store, range(1000)) == 1000
        pending = known(store, range(3000, 3010))
        os.write(tell, b"x")
        fill(store, range(4000, 4010))
        os.read(closed, 1)
        store.close()
        return there and pending == 0

    done = in_a_child(child)
    os.read(looked, 1)
    assert known(store, range(2000, 3010)) == 20
    store.close()  # with SQLite's inherited locks, the child would now write into nothing
    os.write(go_on, b"x")
    assert done()
    assert stored(tmp_path) == 1030


def test_a_fork_from_another_thread(tmp_path: Path) -> None:
    make(tmp_path)
    opened, forked = threading.Event(), threading.Event()
    stores: list[PairStore] = []

    def own() -> None:
        stores.append(PairStore(tmp_path))
        opened.set()
        forked.wait()
        assert known(stores[0], range(1000)) == 1000
        stores[0].close()

    thread = threading.Thread(target=own)
    thread.start()
    opened.wait()
    assert in_a_child(lambda: known(stores[0], range(1000)) == 1000)()
    forked.set()
    thread.join()
    assert stored(tmp_path) == 1000


def test_a_child_that_only_closes(tmp_path: Path) -> None:
    with PairStore(tmp_path) as store:
        fill(store, range(10))
        assert in_a_child(lambda: store.close() is None)()
        assert known(store, range(10)) == 10
    assert stored(tmp_path) == 10


# --- a file a worker


def test_workers_read_what_others_have_closed(tmp_path: Path) -> None:
    one, other = PairStore(tmp_path, "per_worker"), PairStore(tmp_path, "per_worker")
    fill(one, range(10))
    fill(other, range(10, 20))
    one.flush()
    other.flush()
    assert known(one, range(20)) == 10
    one.close()
    other.flush()
    assert known(other, range(20)) == 20
    other.close()
    for mode in ("per_worker", "shared"):
        with PairStore(tmp_path, mode) as third:  # type: ignore[arg-type]
            assert known(third, range(20)) == 20
    merge(tmp_path)
    assert len(list(tmp_path.glob("pairs-*"))) == 1
    for mode in ("per_worker", "shared"):
        with PairStore(tmp_path, mode) as fourth:  # type: ignore[arg-type]
            assert known(fourth, range(20)) == 20


def test_workers_read_a_shared_store_that_nobody_writes(tmp_path: Path) -> None:
    make(tmp_path, 10)
    with PairStore(tmp_path), PairStore(tmp_path, "per_worker") as worker:
        assert known(worker, range(10)) == 0
    with PairStore(tmp_path, "per_worker") as worker:
        assert known(worker, range(10)) == 10


def test_four_workers_and_a_merge(tmp_path: Path) -> None:
    parts = [range(start, start + 1000) for start in (0, 0, 500, 1000)]
    at_once(tmp_path, "per_worker", parts)
    merge(tmp_path)
    assert len(os.listdir(tmp_path)) == 1
    assert stored(tmp_path) == 2000


def test_merge_takes_the_files_of_killed_workers(tmp_path: Path) -> None:
    folder = tmp_path / "pairs"
    for attempt in range(2):
        starts = [attempt * 10**6, attempt * 10**6 + 500_000]
        writers = killed_writers(folder, starts, "per_worker", tmp_path / f"log{attempt}")
        assert list(folder.glob("*.open"))
        merge(folder)
        assert len(list(folder.glob("pairs-*"))) == 1
        with PairStore(folder) as store:
            for start, (put, committed) in zip(starts, writers, strict=True):
                assert known(store, range(start, committed)) == committed - start
                assert known(store, range(start, put)) >= put - start - BATCH


def test_merge_leaves_living_workers_alone(tmp_path: Path) -> None:
    with PairStore(tmp_path, "per_worker") as store:
        fill(store, range(10))
        store.flush()
        merge(tmp_path)
        assert known(store, range(10)) == 10
        assert stored(tmp_path) == 0
    assert stored(tmp_path) == 10


def closed_files(folder: Path, *parts: range) -> list[Path]:
    """One file a part, in their order."""
    paths: list[Path] = []
    for part in parts:
        with PairStore(folder, "per_worker") as store:
            fill(store, part)
        paths += set(folder.glob("pairs-*.sqlite")) - set(paths)
    return paths


def test_merge_takes_what_is_sound_of_damaged_files(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    parts = range(10), range(10, 20), range(20, 120), range(120, 130)
    first, second, third, _ = closed_files(tmp_path, *parts)
    first.write_bytes(b"no store" * 1000)
    sql(second, f"UPDATE pairs SET value = x'00' WHERE key = x'{key(15).hex()}'")
    overwrite(third, third.stat().st_size - 4096, os.urandom(4096))
    merge(tmp_path)
    assert 19 <= stored(tmp_path) < 119
    names = {name.partition(".damaged-")[0] for name in aside(tmp_path)}
    assert names == {first.name, third.name}
    assert len(list(tmp_path.glob("pairs-*.sqlite"))) == 1
    assert capfd.readouterr().err.count("set aside as") == 2


def test_merge_keeps_what_it_cannot_write(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    closed_files(tmp_path, range(10), range(10, 20))

    def full(self: PairStore) -> None:
        self._give_up(OSError("No space left on device"))

    monkeypatch.setattr(PairStore, "_write", full)
    merge(tmp_path)
    monkeypatch.undo()
    assert "No space left on device" in capfd.readouterr().err
    assert stored(tmp_path) == 20
    merge(tmp_path)
    assert stored(tmp_path) == 20
