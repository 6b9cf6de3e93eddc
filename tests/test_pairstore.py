"""The pair store: exact, shared, and never a reason for a run to stop."""

from __future__ import annotations

import dataclasses
import errno
import fcntl
import inspect
import itertools
import multiprocessing
import os
import random
import sqlite3
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import rbtm_bench
from rbtm_bench import pairfiles, pairstore
from rbtm_bench.errors import BackendError
from rbtm_bench.paircodec import DamageError, pack, unpack
from rbtm_bench.pairstore import PairStore, context, merge, pair_key
from rbtm_bench.types import RegistrationResult

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")  # a note that nobody expects

SPAWN = multiprocessing.get_context("spawn")


def key(i: int) -> bytes:
    return blake2b(b"%d" % i, digest_size=24).digest()


def outcome(i: int) -> RegistrationResult | BackendError:
    """What a pair of these tests is: always the same, with every field that may be missing."""
    if i % 11 == 0:
        return BackendError(f"{i}: too few points")
    rng = np.random.default_rng(i)
    return RegistrationResult(
        T_target_source=rng.normal(size=(4, 4)),
        converged=(None, True, False)[i % 3],
        fitness=rng.random(),
        inlier_rmse=float("nan") if i % 5 == 0 else rng.random(),
        inliers=i,
        iterations=None if i % 2 else i,
        seconds=rng.random(),
        information=rng.normal(size=(6, 6)) if i % 4 == 0 else None,
        library_fitness=None if i % 7 else 0.0,
        library_rmse=None if i % 3 else -0.0,
    )


def bits(value: Any) -> Any:
    """A value as something whose equality is that of bits and types."""
    if isinstance(value, BackendError):
        return ("error", str(value))
    if isinstance(value, RegistrationResult):
        return tuple(bits(getattr(value, f.name)) for f in dataclasses.fields(value))
    if isinstance(value, np.ndarray):
        order = value.flags.c_contiguous, value.flags.f_contiguous
        return value.dtype.str, value.shape, order, value.flags.writeable, value.tobytes()
    if isinstance(value, float):
        return struct.pack("<d", value)
    return type(value), value


def fill(store: PairStore, numbers: range) -> None:
    for i in numbers:
        store.put(key(i), outcome(i))


def known(store: PairStore, numbers: range) -> int:
    """How many pairs the store knows; whatever it knows must be right."""
    found = 0
    for i in numbers:
        value = store.get(key(i))
        assert value is None or bits(value) == bits(outcome(i))
        found += value is not None
    return found


def make(folder: Path, pairs: int = 1000) -> Path:
    with PairStore(folder) as store:
        fill(store, range(pairs))
    return folder / "pairs.sqlite"


def aside(folder: Path) -> list[str]:
    names = (path.name for path in folder.iterdir() if ".damaged-" in path.name)
    return sorted(name for name in names if not name.endswith(("-wal", "-shm", "-journal")))


# --- values and keys ----------------------------------------------------------------------------

DOUBLES = st.integers(0, 2**64 - 1).map(lambda n: struct.unpack("<d", struct.pack("<Q", n))[0])
SPECIAL = st.sampled_from([0.0, -0.0, float("nan"), float("inf"), -float("inf"), 5e-324])
FLOATS = DOUBLES | SPECIAL


def matrices(side: int) -> st.SearchStrategy[np.ndarray]:
    size = side * side * 8
    by_rows = st.binary(min_size=size, max_size=size).map(
        lambda b: np.frombuffer(b, np.float64).reshape(side, side).copy()
    )
    return by_rows | by_rows.map(np.asfortranarray)


RESULTS = st.builds(
    RegistrationResult,
    T_target_source=matrices(4),
    converged=st.none() | st.booleans(),
    fitness=FLOATS,
    inlier_rmse=FLOATS,
    inliers=st.integers(0, 2**63 - 1),
    iterations=st.none() | st.integers(-(2**63), 2**63 - 1),
    seconds=FLOATS,
    information=st.none() | matrices(6),
    library_fitness=st.none() | FLOATS,
    library_rmse=st.none() | FLOATS,
)
ERRORS = st.text().map(BackendError)


@pytest.fixture(scope="module")
def one_store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[PairStore, PairStore]]:
    """A store twice: one to write, one to read, as two processes would."""
    folder = tmp_path_factory.mktemp("pairs")
    with PairStore(folder, batch=1) as writer, PairStore(folder) as reader:
        yield writer, reader


counter = itertools.count()


@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(value=RESULTS | ERRORS)
def test_values_come_back_bit_for_bit(one_store: Any, value: Any) -> None:
    writer, reader = one_store
    name = b"%d" % next(counter)
    assert reader.get(name) is None
    writer.put(name, value)
    back = reader.get(name)
    assert type(back) is type(value)
    assert bits(back) == bits(value)
    assert back is not reader.get(name)  # nobody shares arrays with anybody


def test_every_field_of_a_result_is_kept() -> None:
    """A new field must be written too: then raise ``FORMAT`` and add it here."""
    names = [field.name for field in dataclasses.fields(RegistrationResult)]
    names.remove("reused")  # says where a result came from; the caller's business
    assert names == [
        *("T_target_source", "converged", "fitness", "inlier_rmse", "inliers", "iterations"),
        *("seconds", "information", "library_fitness", "library_rmse"),
    ]


@settings(max_examples=200, deadline=None)
@given(value=RESULTS | ERRORS, at=st.integers(0), bit=st.integers(0, 7))
def test_one_changed_bit_is_noticed(value: Any, at: int, bit: int) -> None:
    blob = bytearray(pack(b"key", value))
    blob[at % len(blob)] ^= 1 << bit
    for name, damaged in ((b"key", bytes(blob)), (b"kez", pack(b"key", value)), (b"key", b"")):
        with pytest.raises(DamageError):
            unpack(name, damaged)


def test_pending_pairs_are_found_and_the_first_outcome_stays(tmp_path: Path) -> None:
    with PairStore(tmp_path, batch=10, seconds=100) as store, PairStore(tmp_path) as other:
        store.put(key(1), outcome(1))
        store.put(key(1), outcome(2))
        assert known(store, range(2)) == 1
        assert known(other, range(2)) == 0
        store.flush()
        store.put(key(1), outcome(2))
        store.flush()
        assert known(other, range(2)) == 1


def test_pending_pairs_are_written_after_a_time(tmp_path: Path) -> None:
    with PairStore(tmp_path, seconds=0.05) as store, PairStore(tmp_path) as other:
        store.put(key(1), outcome(1))
        assert known(other, range(2)) == 0
        time.sleep(0.06)
        store.get(key(0))
        assert known(other, range(2)) == 1


@pytest.mark.parametrize(
    "change",
    [
        {"T_target_source": np.eye(4, dtype=np.float32)},
        {"T_target_source": np.eye(3)},
        {"information": np.eye(3)},
        {"iterations": 1.5},
        {"inliers": 2**64},
    ],
)
def test_what_would_change_is_not_kept(tmp_path: Path, change: dict[str, Any]) -> None:
    with PairStore(tmp_path) as store:
        with pytest.warns(RuntimeWarning, match="not kept"):
            store.put(key(1), dataclasses.replace(outcome(1), **change))  # type: ignore[type-var]
        assert store.get(key(1)) is None
        assert len(store.notes) == 1


def test_failures_of_the_machine_are_not_kept(tmp_path: Path) -> None:
    with PairStore(tmp_path) as store:
        try:
            raise BackendError("MyICP: MemoryError") from MemoryError()
        except BackendError as error:
            store.put(key(1), error)
        assert store.get(key(1)) is None


POSE = np.eye(4).tobytes()
NODE = {"_target_": "a.B", "voxel_size": 0.1, "deep": {"rounds": 50, "on": True}, "list": [1, 2]}
CONTEXT = ("abc", NODE, {"numpy": "2.1", "open3d": None})


def test_every_ingredient_changes_the_context() -> None:
    others = [
        ("abd", NODE, CONTEXT[2]),
        ("abc", NODE, {"numpy": "2.2", "open3d": None}),
        ("abc", NODE, {"numpy": "2.1", "open3d": ""}),
        ("abc", NODE, {"numpy": "2.1"}),
        (*CONTEXT, "planar"),
        (*CONTEXT, "2d", "3d"),
        (*CONTEXT, "2d3d"),
        (*CONTEXT, ("2d", "3d")),
    ]
    for change in (
        {"_target_": "a.C"},
        {"voxel_size": float(np.nextafter(0.1, 1))},
        {"voxel_size": "0.1"},
        {"deep": {"rounds": 50.0, "on": True}},
        {"deep": {"rounds": 50, "on": 1}},
        {"deep": {"rounds": 50, "on": None}},
        {"list": [2, 1]},
        {"list": [[1], 2]},
        {"list": [12]},
        {"more": None},
    ):
        others.append(("abc", {**NODE, **change}, CONTEXT[2]))
    contexts = [context(*CONTEXT), *(context(*other) for other in others)]
    assert len(set(contexts)) == len(contexts)


def test_the_order_of_settings_does_not_matter() -> None:
    turned = dict(reversed(NODE.items()))
    turned["deep"] = {"on": True, "rounds": 50}
    assert list(turned) != list(NODE)
    again = context("abc", turned, {"open3d": None, "numpy": "2.1"})
    assert again == context(*CONTEXT)


def test_a_setting_that_is_no_plain_data_is_refused() -> None:
    with pytest.raises(TypeError, match="object"):
        context("abc", {"x": object()}, {})


def test_every_ingredient_changes_the_key() -> None:
    guess = np.arange(16.0).reshape(4, 4)
    one = context(*CONTEXT)
    keys = [
        pair_key(one, ((3, None),), 5, guess),
        pair_key(context("abd", *CONTEXT[1:]), ((3, None),), 5, guess),
        pair_key(one, ((4, None),), 5, guess),
        pair_key(one, ((3, None),), 6, guess),
        pair_key(one, ((3, None),), 5 + 2**32, guess),
        pair_key(one, ((3, POSE),), 5, guess),
        pair_key(one, ((3, b""),), 5, guess),
        pair_key(one, ((3, None), (4, POSE)), 5, guess),
        pair_key(one, ((4, POSE), (3, None)), 5, guess),
        pair_key(one, ((3, POSE), (4, POSE)), 5, guess),
        pair_key(one, (), 5, guess),
    ]
    for index in range(16):
        other = guess.copy()
        other.flat[index] = np.nextafter(other.flat[index], 100)
        keys.append(pair_key(one, ((3, None),), 5, other))
    minus = guess.copy()
    minus[0, 0] = -0.0
    keys.append(pair_key(one, ((3, None),), 5, minus))
    assert len(set(keys)) == len(keys)
    assert pair_key(one, ((3, None),), 5, np.asfortranarray(guess)) == keys[0]
    with pytest.raises(ValueError, match="expected"):
        pair_key(one, ((3, None),), 5, np.eye(3))


# --- many processes -----------------------------------------------------------------------------


def work(folder: Path, numbers: range, mode: Any, queue: Any) -> None:
    """Look up, else "compute", as a run does; tell how many were there already."""
    with PairStore(folder, mode, batch=32, seconds=0.05) as store:
        hits = 0
        for i in numbers:
            value = store.get(key(i))
            assert value is None or bits(value) == bits(outcome(i))
            hits += value is not None
            if value is None:
                store.put(key(i), outcome(i))
        notes = store.notes
    queue.put((hits, notes))


def at_once(folder: Path, mode: str, parts: list[range]) -> list[tuple[int, list[str]]]:
    queue = SPAWN.Queue()
    workers = [SPAWN.Process(target=work, args=(folder, part, mode, queue)) for part in parts]
    for worker in workers:
        worker.start()
    answers = [queue.get(timeout=60) for _ in workers]
    for worker in workers:
        worker.join()
    assert [worker.exitcode for worker in workers] == [0] * len(parts)
    return answers


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


BATCH = 20
WRITE_FOR_EVER = f"""
import os, struct, sys
from pathlib import Path
import numpy as np
from rbtm_bench.errors import BackendError
from rbtm_bench.pairstore import PairStore
from rbtm_bench.types import RegistrationResult
from hashlib import blake2b
{inspect.getsource(key)}
{inspect.getsource(outcome)}
store = PairStore(Path(sys.argv[1]), sys.argv[3], batch={BATCH}, seconds=1e9)
i = committed = int(sys.argv[2])
while True:
    store.put(key(i), outcome(i))
    i += 1
    committed = committed if store._pending else i
    os.write(1, struct.pack("<qq", i, committed))
"""


def killed_writers(folder: Path, starts: list[int], mode: str, log: Path) -> list[tuple[int, int]]:
    """Kill -9 processes that write, at a random moment; how many pairs each had put, and how
    many of them in full batches."""
    here = [str(Path(rbtm_bench.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, here))}
    writers = []
    for start in starts:
        command = [sys.executable, "-c", WRITE_FOR_EVER, str(folder), str(start), mode]
        with open(log.with_suffix(f".{start}"), "wb") as out:
            writers.append(subprocess.Popen(command, stdout=out, env=environment))
    logs = [log.with_suffix(f".{start}") for start in starts]
    try:
        end = time.monotonic() + 30
        while time.monotonic() < end and any(path.stat().st_size == 0 for path in logs):
            time.sleep(0.005)
        time.sleep(random.uniform(0, 0.1))
    finally:
        for writer in writers:
            writer.kill()
            writer.wait()
    told = [path.read_bytes() for path in logs]
    return [struct.unpack("<qq", text[len(text) // 16 * 16 - 16 :][:16]) for text in told]


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
                    found = known(store, range(start, put + BATCH + 1))
                    assert found >= put - start - BATCH
                    total += found
                new = range(10**8 + attempt, 10**8 + attempt + 1)
                fill(store, new)
                store.flush()
                assert known(store, new) == 1
            assert not store.notes
    assert total > 10 * BATCH
    assert aside(folder) == []


# --- damage -------------------------------------------------------------------------------------


def sql(path: Path, *statements: str) -> None:
    db = sqlite3.connect(path)
    for statement in statements:
        db.execute(statement)
    db.commit()
    db.close()


def overwrite(path: Path, offset: int, content: bytes) -> None:
    with open(path, "r+b") as file:
        file.seek(offset)
        file.write(content)


def copy_of_another(path: Path) -> None:
    path.unlink()
    sql(path, "CREATE TABLE guests (name TEXT)", "INSERT INTO guests VALUES ('Besl')")


DAMAGES: dict[str, Callable[[Path], object]] = {
    "no database": lambda path: path.write_bytes(b"not a database, " * 1000),
    "empty": lambda path: path.write_bytes(b""),
    "another program's": copy_of_another,
    "another application": lambda path: sql(path, "PRAGMA application_id=7"),
    "another version": lambda path: sql(path, "PRAGMA user_version=2"),
    "half of it": lambda path: os.truncate(path, path.stat().st_size // 2),
    "first page": lambda path: os.truncate(path, 4096),
    "header only": lambda path: os.truncate(path, 100),
    "another column": lambda path: sql(path, "ALTER TABLE pairs ADD COLUMN x"),
    "no table": lambda path: sql(path, "DROP TABLE pairs"),
    "one more table": lambda path: sql(path, "CREATE TABLE x (y)"),
    "pages of noise": lambda path: overwrite(path, 3 * 4096, os.urandom(3 * 4096)),
    "root of the tree": lambda path: overwrite(path, 4096, bytes(4096)),
    "schema": lambda path: overwrite(path, 100, os.urandom(3996)),
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
def small_store(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return make(tmp_path_factory.mktemp("pairs"), 200).read_bytes()


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_damage_anywhere_is_harmless(
    tmp_path_factory: Any, small_store: bytes, data: st.DataObject
) -> None:
    """Bytes changed at rest, unnoticed at opening: a right value, or none, and no error."""
    folder = tmp_path_factory.mktemp("fuzz")
    path = folder / "pairs.sqlite"
    path.write_bytes(small_store)
    stat = path.stat()
    (folder / "pairs.lock").write_text(pairfiles.stamp(path))
    near_the_start = st.integers(0, 150) | st.integers(4096, 4300)
    for _ in range(data.draw(st.integers(1, 30))):
        at = data.draw(near_the_start | st.integers(0, stat.st_size - 1))
        overwrite(path, at, bytes([data.draw(st.integers(0, 255))]))
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    with (
        pytest.warns(RuntimeWarning, match="trusted|neither|made up"),
        PairStore(folder) as store,
    ):
        pairstore.warnings.warn("made up", RuntimeWarning, stacklevel=1)  # the damage may not show
        known(store, range(200))
        fill(store, range(200, 210))
        store.flush()
        known(store, range(210))


def test_a_damaged_log_is_harmless(tmp_path: Path) -> None:
    writers = killed_writers(tmp_path / "pairs", [0], "shared", tmp_path / "log")
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
    monkeypatch.setattr(pairfiles, "check_pages", lambda db: looks.append(1))
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


# --- no room, no rights, no locks ---------------------------------------------------------------


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


def no_locks(lock: object, how: int) -> None:
    raise OSError(errno.ENOLCK, "No locks available")


def test_without_locks_another_mode_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fcntl, "flock", no_locks)
    with pytest.warns(RuntimeWarning, match="per_worker"):
        store = PairStore(tmp_path)
    given_up(store, "cannot be locked")


def test_a_lock_that_is_never_released(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pairfiles, "_WAIT", 0.05)
    with pairfiles.locked(tmp_path), pytest.warns(RuntimeWarning, match="has been locked"):
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


# --- forks --------------------------------------------------------------------------------------


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
        here = known(store, range(1000)) == 1000
        pending = known(store, range(3000, 3010))
        fill(store, range(4000, 4010))
        os.read(closed, 1)
        store.close()
        return here and pending == 0

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
        assert in_a_child(lambda: store.close() is None)()
        assert known(store, range(10)) == 10
    with PairStore(tmp_path) as store:
        assert known(store, range(10)) == 10


# --- a file a worker ----------------------------------------------------------------------------


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
    for mode in ("shared", "per_worker"):
        with PairStore(tmp_path, mode) as store:  # type: ignore[arg-type]
            assert known(store, range(20)) == 20
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
        assert len(list(folder.glob("*.open"))) == 2
        total = merge(folder)
        assert sorted(os.listdir(folder)) == ["pairs.lock", "pairs.sqlite"]
        with PairStore(folder) as store:
            for start, (put, committed) in zip(starts, writers, strict=True):
                assert known(store, range(start, committed)) == committed - start
                assert known(store, range(start, put)) >= put - start - BATCH
    assert total > 0


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
    first, second, third, _ = pairfiles.sealed_files(tmp_path)
    first.write_bytes(b"no store")
    sql(second, "UPDATE pairs SET value = x'00'")
    os.truncate(third, 4096)
    with pytest.warns(RuntimeWarning, match="not to be trusted"):
        assert merge(tmp_path) == 10
    assert len(aside(tmp_path)) == 3
    assert pairfiles.sealed_files(tmp_path) == []


def test_a_worker_sets_damaged_files_aside(tmp_path: Path) -> None:
    for part in (range(10), range(10, 20), range(20, 30)):
        with PairStore(tmp_path, "per_worker") as store:
            fill(store, part)
    first, second, _ = pairfiles.sealed_files(tmp_path)
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
