"""Sweeps and comparisons that fail, are stopped, killed, and go on."""

from __future__ import annotations

import contextlib
import csv
import importlib.util
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from moody_backend import CONFIGS

from rbtm_bench import sweeps
from rbtm_bench.cli import main
from rbtm_bench.errors import ConfigError, DataError
from rbtm_bench.jobs import Plan
from rbtm_bench.progress import Bar, RunBar
from rbtm_bench.settings import compose_settings
from rbtm_bench.sweeps import Asked

TESTS = Path(__file__).parent
SMALL = ("dataset.scans=12", "selector=previous")
MOODY = ("--config-dir", str(CONFIGS))


def script(name: str) -> ModuleType:
    """A module out of scripts/."""
    spec = importlib.util.spec_from_file_location(name, TESTS.parent / "scripts" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def environment() -> dict[str, str]:
    """This one's, with the moody backend to be found."""
    path = os.environ.get("PYTHONPATH")
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [str(TESTS), path]))}


def begin(*words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "rbtm_bench", *words],
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def call(*words: str, cwd: Path | None = None) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a command in this very process."""
    out, err = io.StringIO(), io.StringIO()
    place = contextlib.chdir(cwd) if cwd else contextlib.nullcontext()
    with place, contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(list(words))
    assert "Traceback" not in err.getvalue(), err.getvalue()
    return code, out.getvalue(), err.getvalue()


def outside(*words: str) -> tuple[int, str, str]:
    """The same of a command in a process of its own."""
    process = begin(*words)
    out, err = process.communicate(timeout=300)
    assert "Traceback" not in err, err
    return process.returncode, out, err


def rows(out: Path) -> dict[str, dict[str, str]]:
    """The table of a sweep, by run."""
    with open(out / "table.csv", newline="") as file:
        return {row["run"]: row for row in csv.DictReader(file)}


def statuses(out: Path) -> list[str]:
    return [row["status"] for row in rows(out).values()]


def record_of(out: Path) -> dict[str, Any]:
    value = json.loads((out / "run.json").read_text())
    assert isinstance(value, dict)
    return value


def edit(path: Path, **values: Any) -> None:
    path.write_text(json.dumps({**json.loads(path.read_text()), **values}))


# --- failures are rows


@pytest.mark.slow
@pytest.mark.parametrize("launcher", ["basic", "joblib"])
def test_failures_of_a_sweep_are_rows(tmp_path: Path, launcher: str) -> None:
    out = tmp_path / "out"
    words = ("backend=moody", "backend.how=none,raise,segfault,hang,exit,none", *SMALL, *MOODY)
    code, _, err = outside(
        "sweep", *words, "time_limit=10", f"hydra/launcher={launcher}", f"out={out}"
    )
    assert code == 1 and "4 of 6 runs failed" in err
    assert [(row["status"], row["reason"]) for row in rows(out).values()] == [
        ("done", ""),
        ("failed", "ZeroDivisionError: division by zero"),
        ("failed", "the process died: signal 11 (SIGSEGV)"),
        ("failed", "time limit of 10 s"),
        ("failed", "the process died: exit code 3"),
        ("done", ""),
    ]
    assert record_of(out / "5")["command"].startswith("rbtm-bench sweep backend=moody")


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_failures_of_a_comparison_are_rows(tmp_path: Path, jobs: str) -> None:
    out = tmp_path / "out"
    words = ("backend=moody", "backend.how=segfault,none,exit", *SMALL, *MOODY, "seed=3")
    code, _, err = call("compare", *words, f"out={out}", "--jobs", jobs)
    assert code == 1 and "2 of 3 runs failed" in err
    found = {name: row["status"] for name, row in rows(out).items()}
    assert found == {
        "moody-previous-how=segfault": "failed",
        "moody-previous-how=none": "done",
        "moody-previous-how=exit": "failed",
    }


@pytest.mark.parametrize("command", ["compare", "sweep"])
def test_fail_fast_and_how_it_goes_on(tmp_path: Path, command: str) -> None:
    out, well = tmp_path / "out", tmp_path / "well"
    words = ["backend=moody", "backend.how=none,raise,none", f"backend.unless={well}", *MOODY]
    one = ["--jobs", "1"] if command == "compare" else []
    seeds = ["seed=0,1", "dataset.range_noise=0.02"] if command == "compare" else []
    code, _, err = call(command, *words, *seeds, *SMALL, f"out={out}", "--fail-fast", *one)
    assert code == 1 and "failed" in err and "not started" in err
    assert "failed" in statuses(out) and len(rows(out)) < 4
    well.touch()
    code, _, err = call(command, "--resume", str(out))
    assert code == 0 and "were done before" in err
    assert set(statuses(out)) == {"done"}


@pytest.mark.slow
def test_fail_fast_with_workers(tmp_path: Path) -> None:
    out = tmp_path / "out"
    how = ",".join(["raise", *["slow"] * 7])
    words = ("backend=moody", f"backend.how={how}", "dataset.scans=60", "selector=previous")
    launcher = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2", f"out={out}", "--fail-fast")
    code, _, err = outside("sweep", *words, *MOODY, *launcher)
    assert code == 1 and "1 of " in err
    assert "not started: " in err and "7 (backend=moody backend.how=slow" in err
    assert len(rows(out)) < 8


@pytest.mark.parametrize("launcher", ["basic", "joblib"])
@pytest.mark.parametrize("word", ["dataset.path=nowhere.clf", "dataset.path=bad.clf,worse.clf"])
def test_bad_data_stop_a_sweep_before_it_begins(tmp_path: Path, launcher: str, word: str) -> None:
    (tmp_path / "bad.clf").write_text("FLASER 180 1 2 3\n")
    words = ("dataset=carmen", word, "selector.threshold=0.5,0.6", f"hydra/launcher={launcher}")
    code, _, err = call("sweep", *words, "out=out", cwd=tmp_path)
    assert code == 2 and len(err.splitlines()) == 1 and ".clf" in err
    assert not (tmp_path / "out").exists()


def test_a_time_limit_of_one_run(tmp_path: Path) -> None:
    words = ("run", "backend=moody", "backend.how=hang", *SMALL, *MOODY, f"out={tmp_path}")
    code, _, err = call(*words, "time_limit=1")
    assert code == 1 and err == "rbtm-bench: time limit of 1 s\n"
    assert record_of(tmp_path)["status"] == "failed"
    for wrong in ("0", "-1", "soon"):
        code, _, err = call(*words, f"time_limit={wrong}")
        assert code == 2 and f"time_limit={wrong}" in err


# --- going on


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a finished sweep of three runs in "s" and a comparison of three in "c"."""
    folder = tmp_path_factory.mktemp("done")
    seeds = ("backend=none", "seed=0,1,2", *SMALL)
    assert call("sweep", *seeds, "out=s", cwd=folder)[0] == 0
    grid = ("backend=none", "selector=rbtm,previous,random_gap", "dataset.scans=12", "out=c")
    assert call("compare", *grid, "selector.threshold=0.3", cwd=folder)[0] == 0
    return folder


@pytest.fixture
def copy(done: Path, tmp_path: Path) -> Iterator[Path]:
    """A copy of those, begun in the copy."""
    shutil.copytree(done, tmp_path, dirs_exist_ok=True)
    for kind in "sc":
        edit(tmp_path / kind / sweeps.FILE, cwd=str(tmp_path))
    yield tmp_path


def numbers(out: Path) -> list[dict[str, str]]:
    cost = ("seconds", "ms_per_scan", "reused")
    return [{k: v for k, v in row.items() if k not in cost} for row in rows(out).values()]


def damage(run: Path, how: str) -> None:
    """What a crash, a kill or a power cut leaves."""
    if how in ("started", "failed"):
        edit(run / "run.json", status=how)
        (run / "metrics.json").unlink()
    elif how == "empty":
        (run / "trajectory.tum").write_text("")
    elif how == "cut":
        (run / "steps.parquet").write_bytes((run / "steps.parquet").read_bytes()[:-100])
    elif how == "half":
        (run / "run.json").unlink()
        (run / ".123.partial.map.npz").write_bytes(b"half")
    elif how == "gone":
        shutil.rmtree(run)
    elif how == "other":
        text = (run / "config.yaml").read_text()
        (run / "config.yaml").write_text(text.replace("map_resolution: 0.05", "map_resolution: 1"))


@pytest.mark.parametrize("how", ["started", "failed", "empty", "cut", "half", "gone", "other"])
def test_only_what_is_missing_is_repeated(copy: Path, done: Path, how: str) -> None:
    kept = {run: (copy / "s" / run / "run.json").read_bytes() for run in "02"}
    damage(copy / "s" / "1", how)
    code, _, err = call("sweep", "--resume", "s", cwd=copy)
    assert code == 0
    assert err.splitlines()[-1] == f"{3 if how == 'other' else 2} of 3 runs were done before"
    assert {run: (copy / "s" / run / "run.json").read_bytes() for run in "02"} == kept
    assert numbers(copy / "s") == numbers(done / "s")
    assert not list(copy.rglob(".*partial*"))
    assert sweeps.is_whole(copy / "s" / "1")


def test_a_comparison_goes_on(copy: Path, done: Path) -> None:
    (gap,) = (copy / "c").glob("*random_gap*")
    (rbtm,) = (copy / "c").glob("*rbtm")
    (previous,) = (copy / "c").glob("*previous")
    kept = {run: (run / "run.json").read_bytes() for run in (rbtm, previous)}
    damage(gap, "started")
    code, _, err = call("compare", "--resume", str(copy / "c"), cwd=TESTS)
    assert code == 0 and "2 of 3 runs were done before" in err
    assert {run: (run / "run.json").read_bytes() for run in (rbtm, previous)} == kept
    assert numbers(copy / "c") == numbers(done / "c")


def test_nothing_is_missing(copy: Path) -> None:
    before = {path: path.read_bytes() for path in copy.rglob("run.json")}
    for kind, folder in (("sweep", "s"), ("compare", "c")):
        assert call(kind, "--resume", folder, cwd=copy)[0] == 0
    assert {path: path.read_bytes() for path in copy.rglob("run.json")} == before


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("sweep --resume nowhere", "nowhere"),
        ("sweep --resume c", "rbtm-bench compare --resume c"),
        ("compare --resume s", "rbtm-bench sweep --resume s"),
        ("sweep --resume s/0", "no sweep was begun there"),
        ("sweep --resume s selector.window=3", "selector.window=3"),
        ("sweep --resume s out=elsewhere", "out=elsewhere"),
    ],
)
def test_what_cannot_be_resumed(done: Path, words: str, named: str) -> None:
    code, _, err = call(*words.split(), cwd=done)
    assert code == 2 and named in err and len(err.splitlines()) == 1


def test_a_damaged_sweep_file_is_named(tmp_path: Path) -> None:
    for text in ("", "{", "[1]", "{}"):
        (tmp_path / sweeps.FILE).write_text(text)
        with pytest.raises(DataError, match=sweeps.FILE):
            Asked.read(tmp_path, "sweep")


def test_how_it_runs_may_change(copy: Path) -> None:
    damage(copy / "s" / "2", "started")
    words = ("--resume", "s", "time_limit=99", "hydra/launcher=joblib")
    assert call("sweep", *words, cwd=copy)[0] == 0
    assert "time_limit: 99" in (copy / "s/2/config.yaml").read_text()
    assert "hydra/launcher=joblib" in Asked.read(copy / "s", "sweep").overrides


def test_other_versions_are_told(copy: Path) -> None:
    stored = Asked.read(copy / "s", "sweep").versions
    edit(copy / "s" / sweeps.FILE, versions={**stored, "open3d": "0.1"})
    damage(copy / "s" / "2", "started")
    code, _, err = call("sweep", "--resume", "s", cwd=copy)
    assert code == 0 and f"open3d was 0.1, is {stored['open3d']}" in err


def test_an_overwritten_sweep_keeps_nothing_of_the_old_one(copy: Path) -> None:
    words = ("backend=none", "seed=7", *SMALL, "out=s")
    assert call("sweep", *words, cwd=copy)[0] == 2
    assert call("sweep", *words, "overwrite=true", cwd=copy)[0] == 0
    assert [row["seed"] for row in rows(copy / "s").values()] == ["7"]


def test_a_folder_at_work_is_left_alone(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweeps, "LOCK_S", 0.2)
    with sweeps.at_work(copy / "s", alone=False), sweeps.at_work(copy / "s", alone=False):
        with pytest.raises(ConfigError, match="still at work"), sweeps.at_work(copy / "s"):
            pass
        assert call("sweep", "--resume", "s", cwd=copy)[0] == 2
    with sweeps.at_work(copy / "s"):
        pass


def test_settings_tell_whether_a_run_is_finished(done: Path) -> None:
    words = ["backend=none", "seed=1", *SMALL]
    assert sweeps.is_finished(done / "s/1", compose_settings(words))
    assert sweeps.is_finished(done / "s/1", compose_settings([*words, "time_limit=5", "out=x"]))
    assert not sweeps.is_finished(done / "s/1", compose_settings([*words, "dataset.scans=13"]))
    assert not sweeps.is_finished(done / "s/0", compose_settings(words))
    assert not sweeps.is_finished(done / "s", compose_settings(words))


# --- stopped


def wait_for(out: Path, count: int) -> None:
    """Until so many runs of a sweep are done."""
    patience = time.monotonic() + 60
    while time.monotonic() < patience:
        if sweeps.count_done(out) >= count:
            return
        time.sleep(0.02)
    raise AssertionError("the sweep does not get on")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "group"),
    [
        (("sweep",), True),
        (("sweep", "hydra/launcher=joblib"), True),  # as a terminal does it
        (("sweep", "hydra/launcher=joblib"), False),
        (("compare", "--jobs", "2"), True),
    ],
)
def test_ctrl_c(tmp_path: Path, words: tuple[str, ...], group: bool) -> None:
    out = tmp_path / "out"
    grid = ("backend=moody", "backend.how=slow", "dataset.scans=30,31,32,33,34,35,36,37,38,39")
    process = begin(*words, *grid, "selector=previous", *MOODY, f"out={out}")
    wait_for(out, 2)
    (os.killpg if group else os.kill)(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert f"rbtm-bench {words[0]} --resume {out}" in err
    assert "Traceback" not in err, err
    finished = {p: p.read_bytes() for p in out.glob("*/run.json") if record_of(p.parent)["seconds"]}
    assert 2 <= len(finished) < 10
    code, _, err = call(words[0], "--resume", str(out))
    assert code == 0 and statuses(out) == ["done"] * 10
    assert {p: p.read_bytes() for p in finished} == finished


@pytest.mark.slow
@pytest.mark.parametrize("words", [[], ["--launcher", "joblib", "--parent-only"]])
def test_killed_at_random_moments(
    tmp_path: Path, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    times = "3" if words else "10"
    code = script("kill_sweep").main(["--times", times, "--out", str(tmp_path), *words])
    assert code == 0, capsys.readouterr().out
    assert f"kills: {times}" in capsys.readouterr().out


@pytest.fixture
def tiny_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 150 kB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=152k", "tmpfs", str(folder)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("needs the right to mount a file system")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


@pytest.mark.parametrize("command", ["sweep", "compare"])
def test_a_full_disk(tiny_disk: Path, command: str) -> None:
    out = tiny_disk / "out"
    words = ("backend=none", "dataset.scans=12,13,14,15,16,17", "selector=previous")
    code, shown, err = call(command, *words, f"out={out}")
    assert code == 1 and "No space left on device" in shown + err
    grow = ["mount", "-o", "remount,size=20m", str(tiny_disk)]
    subprocess.run(grow, check=True)
    finished = [p for p in out.glob("*/run.json") if sweeps.is_whole(p.parent)]
    before = {p: p.read_bytes() for p in finished}
    assert 0 < len(before) < 6
    code, _, err = call(command, "--resume", str(out))
    assert code == 0 and f"{len(before)} of 6 runs were done before" in err
    assert statuses(out) == ["done"] * 6
    assert {p: p.read_bytes() for p in before} == before


def test_ctrl_c_is_not_lost_inside_a_library() -> None:
    with pytest.raises(KeyboardInterrupt), sweeps.minding_ctrl_c():
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise ValueError("an error of the library's own") from None
    with pytest.raises(KeyboardInterrupt), sweeps.minding_ctrl_c():
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        sweeps.check_ctrl_c()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    with pytest.raises(ValueError, match="own"), sweeps.minding_ctrl_c():
        sweeps.check_ctrl_c()
        raise ValueError("its own")


# --- plan and bar


def test_the_plan_names_every_job_in_hydras_order() -> None:
    plan = Plan.of(["backend=none,open3d_p2p", "seed=1,2", "hydra/launcher=joblib"], ())
    assert plan.jobs == [
        ["backend=none", "seed=1"],
        ["backend=none", "seed=2"],
        ["backend=open3d_p2p", "seed=1"],
        ["backend=open3d_p2p", "seed=2"],
    ]
    assert not plan.one_process and Plan.of(["seed=1"], ()).one_process
    assert {(s.choices["backend"], s.config["seed"]) for s in plan.settings} == {
        ("none", 1),
        ("open3d_p2p", 1),
        ("none", 2),
    }


@pytest.mark.parametrize(
    "word", ["hydra.sweep.dir=x", "hydra.sweep.subdir=x", "hydra/launcher=nix", "seed=1,a"]
)
def test_a_plan_that_cannot_be(word: str) -> None:
    with pytest.raises(ConfigError):
        Plan.of([word], ())


def test_the_bar_counts_and_estimates() -> None:
    now = 0.0
    bar = RunBar(Bar(), 12, reused=2, clock=lambda: now)
    assert bar.text() == "0 done, 2 reused"
    now = 20.0
    bar.ended("a", True)
    bar.part("b", 5, 10)
    assert bar.text() == "1 done, 2 reused, 1:53 left"  # 1.5 of 10 in 20 s
    bar.ended("b", False)
    assert bar.text() == "1 done, 2 reused, 1 failed, 1:20 left"
    now = 3600.0
    assert bar.text() == "1 done, 2 reused, 1 failed, 4:00:00 left"
    assert RunBar(Bar(), None).text() == "0 done"
