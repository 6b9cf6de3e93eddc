"""Pairs with known outcomes, and processes that write them, for the tests of the pair store."""

from __future__ import annotations

import dataclasses
import inspect
import multiprocessing
import os
import random
import sqlite3
import struct
import subprocess
import sys
import time
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np

import rbtm_bench
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.types import Localizability, RegistrationResult
from rbtm_bench.pairs.store import PairStore

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
        localizability=(
            None,
            Localizability(rng.normal(size=(3, 3)), rng.random()),
            Localizability(rng.normal(size=(6, 6)), rng.random()),
        )[i % 3],
    )


def bits(value: Any) -> Any:
    """A value as something whose equality is that of bits and types."""
    if isinstance(value, BackendError):
        return ("error", str(value))
    if isinstance(value, RegistrationResult | Localizability):
        names = [f.name for f in dataclasses.fields(value) if f.name != "reused"]
        return tuple(bits(getattr(value, name)) for name in names)
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


def work(folder: Path, numbers: range, mode: Any, queue: Any) -> None:
    """Look up, else "compute", as a run does; tell how many were there already."""
    with PairStore(folder, mode, batch=32, seconds=0.05) as store:
        hits = 0
        for i in numbers:
            there = known(store, range(i, i + 1))
            if not there:
                store.put(key(i), outcome(i))
            hits += there
    queue.put(hits)


def at_once(folder: Path, mode: str, parts: list[range]) -> list[int]:
    queue = SPAWN.Queue()
    workers = [SPAWN.Process(target=work, args=(folder, part, mode, queue)) for part in parts]
    for worker in workers:
        worker.start()
    answers = [queue.get(timeout=60) for _ in workers]
    for worker in workers:
        worker.join()
    assert [worker.exitcode for worker in workers] == [0] * len(parts)
    return answers


BATCH = 20
WRITE_FOR_EVER = f"""
import os, struct, sys
from pathlib import Path
import numpy as np
from rbtm_bench.core.errors import BackendError
from rbtm_bench.pairs.store import PairStore
from rbtm_bench.core.types import Localizability, RegistrationResult
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


def killed_writers(
    folder: Path, starts: list[int], mode: str, log: Path, least: int = 1
) -> list[tuple[int, int]]:
    """Kill -9 processes that write, at a random moment after ``least`` pairs; how many pairs each
    had put, and how many of them in full batches."""
    places = [str(Path(rbtm_bench.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, places))}
    writers = []
    for start in starts:
        command = [sys.executable, "-c", WRITE_FOR_EVER, str(folder), str(start), mode]
        with open(log.with_suffix(f".{start}"), "wb") as out:
            writers.append(subprocess.Popen(command, stdout=out, env=environment))
    logs = [log.with_suffix(f".{start}") for start in starts]
    try:
        end = time.monotonic() + 30
        while time.monotonic() < end and any(path.stat().st_size < 16 * least for path in logs):
            time.sleep(0.005)
        time.sleep(random.uniform(0, 0.1))
    finally:
        for writer in writers:
            writer.kill()
            writer.wait()
    reports = [path.read_bytes() for path in logs]
    return [struct.unpack("<qq", text[len(text) // 16 * 16 - 16 :][:16]) for text in reports]


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
