"""Sweeps and comparisons that fail or were not finished, and go on."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from sweep_helpers import MOODY, SMALL, TESTS, call, edit, outside, record_of, rows, statuses

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.engine import sweep_folder
from rbtm_bench.engine.sweep_folder import Asked
from rbtm_bench.metrics.cost import COLUMNS
from rbtm_bench.runs.settings import compose_settings

# --- failures are rows


@pytest.mark.slow
@pytest.mark.parametrize("launcher", ["basic", "joblib"])
def test_failures_of_a_sweep_are_rows(tmp_path: Path, launcher: str) -> None:
    out = tmp_path / "out"
    words = ("backend=moody", "backend.how=none,raise,segfault,hang,exit,none", *SMALL, *MOODY)
    code, _, err = outside(
        "sweep", *words, "time_limit=5", f"hydra/launcher={launcher}", f"out={out}"
    )
    assert code == 1 and "4 of 6 runs failed" in err
    assert [(row["status"], row["reason"]) for row in rows(out).values()] == [
        ("done", ""),
        ("failed", "backend=moody: ZeroDivisionError: division by zero"),
        ("failed", "backend=moody: the process died: signal 11 (SIGSEGV)"),
        ("failed", "backend=moody: time limit of 5 s"),
        ("failed", "backend=moody: the process died: exit code 3"),
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
    code, _, err = call(command, "--resume", str(out), "--trust")
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
    assert code == 1 and err == "rbtm-bench: backend=moody: time limit of 1 s\n"
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
        edit(tmp_path / kind / sweep_folder.FILE, cwd=str(tmp_path))
    yield tmp_path


def numbers(out: Path) -> list[dict[str, str]]:
    """A table's rows without what differs from time to time."""
    costs = ("seconds", "reused", *COLUMNS)
    return [{k: v for k, v in row.items() if k not in costs} for row in rows(out).values()]


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
    assert sweep_folder.is_whole(copy / "s" / "1")


def test_a_comparison_goes_on(copy: Path, done: Path) -> None:
    (gap,) = (copy / "c").glob("*random_gap*")
    (rbtm,) = (copy / "c").glob("*rbtm")
    (previous,) = (copy / "c").glob("*previous")
    kept = {run: (run / "run.json").read_bytes() for run in (rbtm, previous)}
    damage(gap, "started")
    code, _, err = call("compare", "--resume", str(copy / "c"), "--trust", cwd=TESTS)
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
        (tmp_path / sweep_folder.FILE).write_text(text)
        with pytest.raises(DataError, match=sweep_folder.FILE):
            Asked.read(tmp_path, "sweep")


def test_how_it_runs_may_change(copy: Path) -> None:
    damage(copy / "s" / "2", "started")
    words = ("--resume", "s", "time_limit=99", "hydra/launcher=joblib")
    assert call("sweep", *words, cwd=copy)[0] == 0
    assert "time_limit: 99" in (copy / "s/2/config.yaml").read_text()
    assert "hydra/launcher=joblib" in Asked.read(copy / "s", "sweep").overrides


def test_other_versions_are_told(copy: Path) -> None:
    stored = Asked.read(copy / "s", "sweep").versions
    edit(copy / "s" / sweep_folder.FILE, versions={**stored, "open3d": "0.1"})
    damage(copy / "s" / "2", "started")
    code, _, err = call("sweep", "--resume", "s", cwd=copy)
    assert code == 0 and f"open3d was 0.1, is {stored['open3d']}" in err


def test_an_overwritten_sweep_keeps_nothing_of_the_old_one(copy: Path) -> None:
    words = ("backend=none", "seed=7", *SMALL, "out=s")
    assert call("sweep", *words, cwd=copy)[0] == 2
    assert call("sweep", *words, "overwrite=true", cwd=copy)[0] == 0
    assert [row["seed"] for row in rows(copy / "s").values()] == ["7"]


def test_a_folder_at_work_is_left_alone(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweep_folder, "LOCK_S", 0.2)
    with (
        sweep_folder.at_work(copy / "s", alone=False),
        sweep_folder.at_work(copy / "s", alone=False),
    ):
        with pytest.raises(ConfigError, match="still at work"), sweep_folder.at_work(copy / "s"):
            pass
        assert call("sweep", "--resume", "s", cwd=copy)[0] == 2
    with sweep_folder.at_work(copy / "s"):
        pass


def test_settings_tell_whether_a_run_is_finished(done: Path) -> None:
    words = ["backend=none", "seed=1", *SMALL]
    assert sweep_folder.is_finished(done / "s/1", compose_settings(words))
    assert sweep_folder.is_finished(
        done / "s/1", compose_settings([*words, "time_limit=5", "out=x"])
    )
    assert not sweep_folder.is_finished(
        done / "s/1", compose_settings([*words, "dataset.scans=13"])
    )
    assert not sweep_folder.is_finished(done / "s/0", compose_settings(words))
    assert not sweep_folder.is_finished(done / "s", compose_settings(words))
