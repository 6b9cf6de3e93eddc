"""A run that takes more memory than it may is a row, and nothing of it stays."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from moody_backend import GOBBLE
from sweep_helpers import MOODY, SMALL, call, record_of, rows

from rbtm_bench.engine.traces import descendants, resident_mb
from rbtm_bench.runs.settings import compose_settings

HOLDS = "import sys, time; x = b'x' * 100_000_000; print(flush=True); time.sleep(600)"


def gobbling() -> list[str]:
    """Processes of the greedy backend's that are still there."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().decode(errors="replace")
        except OSError:
            continue
        if str(GOBBLE) in words:
            found.append(words)
    return found


def test_memory_is_that_of_a_process_and_its_descendants() -> None:
    before = resident_mb(os.getpid())
    own = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {HOLDS!r}])"
    with subprocess.Popen(
        [sys.executable, "-c", own], stdout=subprocess.PIPE, start_new_session=True
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        everyone = [os.getpid(), *descendants(os.getpid())]
        assert process.pid in everyone and len(everyone) >= 3
        assert 100 < resident_mb(process.pid) < 200
        assert resident_mb(os.getpid()) > before + 100
        os.killpg(process.pid, 9)
    assert resident_mb(process.pid) == 0.0


@pytest.mark.parametrize("command", ["compare", "sweep"])
def test_more_memory_than_allowed_is_a_row(tmp_path: Path, command: str) -> None:
    out = tmp_path / "out"
    words = ("backend=moody", "backend.how=gobble,gobble_elsewhere,none", *SMALL, *MOODY)
    began = time.monotonic()
    code, _, err = call(command, *words, "memory_limit=500", "pictures=false", f"out={out}")
    assert code == 1 and "2 of 3 runs failed" in err
    assert time.monotonic() - began < 60.0
    *greedy, calm = rows(out).values()
    for row in greedy:
        found = re.fullmatch(
            r"backend=moody: more than memory_limit=500 MB \((\d+) MB\)", row["reason"]
        )
        assert row["status"] == "failed" and found is not None, row
        assert 500 < int(found[1]) < 1500
    assert calm["status"] == "done"
    assert not gobbling(), "what the backend had started is still there"


def test_a_memory_limit_of_one_run(tmp_path: Path) -> None:
    words = ("run", "backend=moody", "backend.how=gobble", *SMALL, *MOODY, f"out={tmp_path / 'o'}")
    code, _, err = call(*words, "memory_limit=500")
    assert code == 1 and err.startswith(
        "rbtm-bench: backend=moody: more than memory_limit=500 MB ("
    )
    assert record_of(tmp_path / "o")["status"] == "failed"
    for wrong in ("0", "-1", "much"):
        code, _, err = call(*words, f"memory_limit={wrong}")
        assert code == 2 and f"memory_limit={wrong}" in err


def test_a_memory_limit_tells_no_runs_apart(tmp_path: Path) -> None:
    first, second = (compose_settings([f"memory_limit={limit}"]) for limit in ("null", "900"))
    assert first.identity == second.identity
    out = tmp_path / "out"
    words = ("backend=moody", "backend.how=none,gobble", *SMALL, *MOODY, f"out={out}")
    assert call("compare", *words, "memory_limit=500")[0] == 1
    code, _, err = call(
        "compare", "--resume", str(out), "--trust", "memory_limit=600", "time_limit=30"
    )
    assert code == 1 and "1 of 2 runs were done before" in err
    assert "more than memory_limit=600 MB" in rows(out)["moody-previous-how=gobble"]["reason"]
