"""Runs in supervised children: whatever happens to a child is one failed row."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from moody_backend import CONFIGS

from rbtm_bench.core.errors import ConfigError, DataError, RunError
from rbtm_bench.engine.crew import (
    ChildError,
    StoppedError,
    Supervisor,
    cause_of_death,
    own_supervisor,
)
from rbtm_bench.runs.settings import Settings, compose_settings

TESTS = Path(__file__).parents[1]


def settings(how: str = "none", *words: str, scans: int = 12) -> Settings:
    common = ["backend=moody", f"backend.how={how}", "selector=previous", f"dataset.scans={scans}"]
    return compose_settings([*common, *words], (CONFIGS,))


@pytest.fixture(scope="module")
def supervisor() -> Iterator[Supervisor]:
    with Supervisor() as one:
        yield one


def alive(pid: int) -> bool:
    """True for a process that is there and no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def wait_until(true: Any, seconds: float = 20.0) -> bool:
    patience = time.monotonic() + seconds
    while time.monotonic() < patience:
        if true():
            return True
        time.sleep(0.02)
    return bool(true())


def record_of(out: Path) -> dict[str, Any]:
    value = json.loads((out / "run.json").read_text())
    assert isinstance(value, dict)
    return value


# --- one run


def test_a_run_gives_its_record(supervisor: Supervisor, tmp_path: Path) -> None:
    record = supervisor.run("a", settings(), tmp_path / "a")
    assert record["status"] == "done"
    assert record == record_of(tmp_path / "a")
    assert (tmp_path / "a" / "metrics.json").exists()


@pytest.mark.parametrize(
    ("how", "reason"),
    [
        ("raise", "backend=moody: ZeroDivisionError: division by zero"),
        ("leave", "backend=moody: SystemExit: licence expired"),
        ("segfault", "backend=moody: the process died: signal 11 (SIGSEGV)"),
        ("exit", "backend=moody: the process died: exit code 3"),
    ],
)
def test_a_failure_is_a_row_and_the_next_run_goes_well(
    supervisor: Supervisor, tmp_path: Path, how: str, reason: str
) -> None:
    record = supervisor.run("bad", settings(how), tmp_path / "bad")
    stored = record_of(tmp_path / "bad")
    for one in (record, stored):
        assert (one["status"], one["reason"]) == ("failed", reason)
    assert stored["scans"] == 12 and stored["dataset_fingerprint"] and stored["finished"]
    assert not (tmp_path / "bad" / "metrics.json").exists()
    assert supervisor.run("good", settings(), tmp_path / "good")["status"] == "done"


def test_a_crash_tells_where_it_was(supervisor: Supervisor, tmp_path: Path) -> None:
    supervisor.run("bad", settings("segfault"), tmp_path)
    trace = record_of(tmp_path)["traceback"]
    assert "Segmentation fault" in trace and "moody_backend.py" in trace and "build" in trace


@pytest.mark.parametrize("how", ["hang", "hang_in_c", "fork_and_hang"])
def test_time_limit(supervisor: Supervisor, tmp_path: Path, how: str) -> None:
    supervisor.call(os.getpid)
    first = supervisor.pid
    supervisor.run("warm", settings(), tmp_path / "warm")
    began = time.monotonic()
    record = supervisor.run("slow", settings(how, "time_limit=1.5"), tmp_path / "slow")
    assert 1.4 < time.monotonic() - began < 10.0
    assert (record["status"], record["reason"]) == ("failed", "backend=moody: time limit of 1.5 s")
    assert record_of(tmp_path / "slow")["reason"] == record["reason"]
    assert first is not None and not alive(first)
    assert not sleeping("617"), "what the backend had started is still there"
    assert (
        supervisor.run("next", settings("none", "time_limit=60"), tmp_path / "next")["status"]
        == "done"
    )


def sleeping(seconds: str) -> bool:
    """True if a ``sleep`` of this length runs anywhere."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            found.append(path.read_bytes().split(b"\0"))
        except OSError:
            continue
    return any(words[:2] == [b"sleep", seconds.encode()] for words in found)


def test_unfit_settings_are_a_row(supervisor: Supervisor, tmp_path: Path) -> None:
    unfit = compose_settings(["dataset=carmen", "dataset.path=nowhere.clf"])
    record = supervisor.run("unfit", unfit, tmp_path / "unfit")
    assert record["status"] == "failed" and "nowhere.clf" in record["reason"]
    assert record_of(tmp_path / "unfit")["status"] == "failed"


def test_files_of_others_are_left_alone(supervisor: Supervisor, tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text('{"status": "done"}')
    record = supervisor.run("a", settings(), tmp_path)
    assert record["status"] == "failed" and "overwrite=true" in record["reason"]
    assert record_of(tmp_path) == {"status": "done"}


# --- the child


def test_one_child_stays_for_all_runs(supervisor: Supervisor, tmp_path: Path) -> None:
    pids = set()
    for name in "abc":
        assert supervisor.run(name, settings(), tmp_path / name)["status"] == "done"
        pids.add(supervisor.pid)
    assert len(pids) == 1 and None not in pids


def test_an_idle_child_that_died_is_replaced(supervisor: Supervisor, tmp_path: Path) -> None:
    supervisor.call(os.getpid)
    first = supervisor.pid
    assert first is not None
    os.kill(first, signal.SIGKILL)
    assert supervisor.run("a", settings(), tmp_path)["status"] == "done"
    assert supervisor.pid not in (None, first)


def test_the_child_is_pinned_and_its_parent_is_not(supervisor: Supervisor, tmp_path: Path) -> None:
    cores = os.sched_getaffinity(0)
    supervisor.run("a", settings(), tmp_path / "a")
    pinned = supervisor.pid
    assert pinned is not None and len(os.sched_getaffinity(pinned)) == 1
    assert os.sched_getaffinity(0) == cores
    assert record_of(tmp_path / "a")["core"] in cores
    supervisor.run("b", settings("none", "pin=false"), tmp_path / "b")
    free = supervisor.pid
    assert free is not None and free != pinned and os.sched_getaffinity(free) == cores
    assert record_of(tmp_path / "b")["core"] is None


def test_what_is_printed_does_no_harm(
    supervisor: Supervisor, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert supervisor.run("a", settings("print"), tmp_path)["status"] == "done"
    captured = capfd.readouterr()
    assert captured.out == "" and captured.err.count("noise") == 2


def test_progress_comes_now_and_then(supervisor: Supervisor, tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    slow = settings("slow", scans=60)
    supervisor.run("a", slow, tmp_path, progress=lambda *at: seen.append(at))
    assert 2 <= len(seen) < 40
    assert seen == sorted(seen) and {total for _, total in seen} == {60}


def test_a_call_gives_values_and_errors(supervisor: Supervisor) -> None:
    assert supervisor.call(divmod, 7, 2) == (3, 1)
    with pytest.raises(RunError, match="ZeroDivisionError"):
        supervisor.call(divmod, 7, 0)
    for kind in (ConfigError, DataError):
        with pytest.raises(kind, match="no good"):
            supervisor.call(complain, kind)
    with pytest.raises(ChildError, match="exit code 3"):
        supervisor.call(os._exit, 3)
    assert supervisor.call(os.getpid) == supervisor.pid


def complain(kind: type[Exception]) -> None:
    raise kind("no good")


def test_a_killed_supervisor_stops_its_run(tmp_path: Path) -> None:
    supervisor = Supervisor()

    def kill() -> None:
        assert wait_until((tmp_path / "a" / "run.json").exists, 60)
        supervisor.kill()

    threading.Thread(target=kill).start()
    with pytest.raises(StoppedError):
        supervisor.run("a", settings("hang"), tmp_path / "a")
    assert record_of(tmp_path / "a")["status"] == "started"
    with pytest.raises(StoppedError):
        supervisor.run("b", settings(), tmp_path / "b")


def test_threads_have_children_of_their_own(tmp_path: Path) -> None:
    pids: list[int | None] = []
    mild = settings()

    def work(name: str) -> None:
        with Supervisor() as mine:
            assert mine.run(name, mild, tmp_path / name)["status"] == "done"
            pids.append(mine.pid)

    threads = [threading.Thread(target=work, args=(name,)) for name in "ab"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(set(pids)) == 2


def test_own_supervisor_is_one_a_process() -> None:
    assert own_supervisor() is own_supervisor()


def test_a_child_works_where_its_parent_does(
    supervisor: Supervisor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert supervisor.call(os.getcwd) == os.getcwd()
    monkeypatch.chdir(tmp_path)
    assert supervisor.call(os.getcwd) == str(tmp_path)
    with Supervisor(TESTS, ["rbtm-bench", "sweep"]) as placed:
        assert placed.call(os.getcwd) == str(TESTS)
        record = placed.run("a", settings(), tmp_path / "a")
    assert record["command"] == "rbtm-bench sweep"


def test_causes_of_death() -> None:
    assert cause_of_death(3) == "exit code 3"
    assert cause_of_death(-11) == "signal 11 (SIGSEGV)"
    assert cause_of_death(-9) == "signal 9 (SIGKILL; perhaps out of memory)"
    assert cause_of_death(-99) == "signal 99 (unknown)"


# --- the parent's end

PARENT = """
import sys
from pathlib import Path
sys.path[:0] = [{tests!r}, {tests!r} + "/engine"]
from test_crew import settings
from rbtm_bench.engine.crew import Supervisor

supervisor = Supervisor()
supervisor.call(divmod, 1, 1, serves=frozenset({{"moody_backend"}}))
Path({out!r}, "pid").write_text(str(supervisor.pid))
supervisor.run("a", settings({how!r}), Path({out!r}, "run"))
"""


@pytest.mark.parametrize("how", ["hang", "hang_in_c"])
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_no_orphans(tmp_path: Path, how: str, number: int) -> None:
    code = PARENT.format(tests=str(TESTS), out=str(tmp_path), how=how)
    parent = subprocess.Popen([sys.executable, "-c", code])
    try:
        assert wait_until((tmp_path / "run" / "run.json").exists, 60)
        time.sleep(0.5)
        child = int((tmp_path / "pid").read_text())
        assert alive(child)
    finally:
        parent.send_signal(number)
        parent.wait()
    assert wait_until(lambda: not alive(child), 2.0)


def test_ctrl_c_is_for_the_parent(supervisor: Supervisor) -> None:
    supervisor.call(os.getpid)
    pid = supervisor.pid
    assert pid is not None and os.getpgid(pid) != os.getpgid(0)
    os.kill(pid, signal.SIGINT)
    assert supervisor.call(os.getpid) == pid


def test_a_parent_never_loads_a_backend_library(tmp_path: Path) -> None:
    code = (
        "import sys; from rbtm_bench.cli.commands import main; "
        "code = main(['compare', 'backend=open3d_p2p', 'selector=previous', 'dataset.scans=12', "
        f"'out={tmp_path / 'out'}', '--jobs', '1']); "
        "print(code, 'open3d' in sys.modules, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stderr.split()[-2:] == ["0", "False"], done.stderr
