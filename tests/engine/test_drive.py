"""Many runs side by side: a failed one is a row like any other, and the others finish."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from rbtm_bench.cli.commands import main
from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.engine import drive, one_run
from rbtm_bench.runs.grid import make_points

PLUGINS = '''
import os
import signal

from rbtm_bench.backends.base import Alignment, Backend


class Deadly(Backend):
    """Like backend=none, but at the 4th scan it raises, or its process dies."""

    def __init__(self, how: str = "none") -> None:
        super().__init__()
        self.how, self.calls = how, 0

    def build(self, points, planar):
        self.calls += 1
        if self.calls == 4 and self.how == "raise":
            raise RuntimeError("out of luck")
        if self.calls == 4 and self.how == "die":
            os.kill(os.getpid(), signal.SIGKILL)

    def align(self, source, target, T_target_source):
        return Alignment(T_target_source)


class Refuses(Deadly):
    def __init__(self) -> None:
        raise ValueError("no licence found")
'''


@pytest.fixture
def extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Configs of backends that fail; new worker processes find their module too."""
    (tmp_path / "deadly_plugins.py").write_text(PLUGINS)
    configs = tmp_path / "deadly_configs" / "backend"
    configs.mkdir(parents=True)
    (configs / "deadly.yaml").write_text("_target_: deadly_plugins.Deadly\nhow: none\n")
    (configs / "refuses.yaml").write_text("_target_: deadly_plugins.Refuses\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    return configs.parent


def compare(out: Path, *words: str, jobs: int = 1) -> int:
    """Exit code of a comparison of small runs, in this process and not pinned."""
    common = ["dataset.scans=12", "pin=false", "controls=none", f"out='{out}'"]
    common += ["--jobs", str(jobs)]
    return main(["compare", *common, *words])


def record_of(out: Path) -> dict[str, Any]:
    value = json.loads((out / "run.json").read_text())
    assert isinstance(value, dict)
    return value


def statuses(out: Path) -> dict[str, str]:
    table = pd.read_csv(out / "table.csv", keep_default_na=False)
    return dict(zip(table["run"], table["status"], strict=True))


# --- what a comparison leaves


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two selectors and random_gap, two windows, two seeds."""
    out = tmp_path_factory.mktemp("comparison") / "out"
    words = ["backend=none", "selector=previous,rbtm,random_gap", "selector.window=3,6"]
    assert compare(out, *words, "selector.threshold=0.3", "seed=0,1") == 0
    return out


def test_a_folder_a_run_and_two_tables(done: Path) -> None:
    entries = {p.name for p in done.iterdir()}
    runs = {p.parent.name for p in done.glob("*/run.json")}
    assert len(runs) == 2 + 4 + 4
    assert entries == runs | {"table.csv", "summary.csv", "sweep.json", "pairs"}
    assert set(statuses(done)) == runs and set(statuses(done).values()) == {"done"}


def test_table_has_a_row_a_run_and_summary_a_row_a_method(done: Path) -> None:
    table = pd.read_csv(done / "table.csv")
    summary = pd.read_csv(done / "summary.csv")
    assert len(table) == 10 and len(summary) == 5
    assert list(summary["seeds"]) == [2] * 5
    assert sorted(table["seed"].unique()) == [0, 1]
    key = "final_translation_error_mm"
    rows = table[(table["selector"] == "rbtm") & (table["window"] == 6)]
    method = summary[(summary["selector"] == "rbtm") & (summary["window"] == 6)]
    assert method[key].item() == pytest.approx(rows[key].median())


def test_random_gap_draws_from_its_own_rbtm_run(done: Path) -> None:
    for folder in done.glob("none-random_gap-*"):
        config = (folder / "config.yaml").read_text()
        source = next(line for line in config.splitlines() if "gaps_from" in line)
        followed = Path(source.split(":", 1)[1].strip())
        assert followed.parent == done and followed.name.startswith("none-rbtm-window=")
        assert folder.name.endswith(f"of-{followed.name}")
        assert record_of(folder)["started"] >= record_of(followed)["finished"]
        assert record_of(folder)["seed"] == record_of(followed)["seed"]


def test_the_screen_has_table_verdict_and_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = ("backend=none,kiss_icp", "selector=previous,rbtm", "selector.window=4")
    assert compare(out, *words, "selector.threshold=0.3") == 0
    captured = capsys.readouterr()
    opening, line = captured.err.splitlines()
    assert opening.startswith("4 runs, all new; ")
    assert re.fullmatch(r"1 of 4 runs: 1 done, .* left", line)
    assert "corridor, kiss_icp: final position error of rbtm (window 4, threshold 0.3)" in (
        captured.out
    )
    assert f"{out / 'table.csv'}" in captured.out and f"rbtm-bench plot {out}" in captured.out
    assert "Traceback" not in captured.out


def test_merged_points_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("backend=none", "selector=previous,rbtm", "selector.window=4,6")
    assert compare(tmp_path, *words) == 0
    assert "merged: selector=previous has no selector.window" in capsys.readouterr().err
    assert len(statuses(tmp_path)) == 3


# --- failures


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_failed_run_is_a_row_and_the_others_finish(
    tmp_path: Path, extra: Path, capsys: pytest.CaptureFixture[str], jobs: int
) -> None:
    out = tmp_path / "out"
    words = ("backend=deadly", "backend.how=none,raise", "selector=previous,fixed_gap")
    assert compare(out, *words, "--config-dir", str(extra), jobs=jobs) == 1
    assert statuses(out) == {
        "deadly-previous-how=none": "done",
        "deadly-previous-how=raise": "failed",
        "deadly-fixed_gap-how=none": "done",
        "deadly-fixed_gap-how=raise": "failed",
    }
    captured = capsys.readouterr()
    assert "2 of 4 runs failed" in captured.err
    assert "RuntimeError: out of luck" in captured.out
    assert "0 of 1 done" in captured.out
    table = pd.read_csv(out / "table.csv").set_index("run")
    reason = table.loc["deadly-previous-how=raise", "reason"]
    assert reason == "backend=deadly: RuntimeError: out of luck"
    assert pd.isna(table.loc["deadly-previous-how=raise", "ape_rmse_m"])  # empty, not 0
    assert table.loc["deadly-previous-how=none", "ape_rmse_m"] > 0


def test_a_backend_that_cannot_even_start_is_a_row(tmp_path: Path, extra: Path) -> None:
    out = tmp_path / "out"
    words = ("backend=refuses,none", "selector=previous", "--config-dir", str(extra))
    assert compare(out, *words) == 1
    assert statuses(out) == {"refuses-previous": "failed", "none-previous": "done"}
    assert "no licence found" in record_of(out / "refuses-previous")["reason"]


def test_a_killed_worker_is_a_row_and_the_others_finish(
    tmp_path: Path, extra: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = ("backend=deadly", "backend.how=die,none", "selector=previous,fixed_gap,rbtm")
    assert compare(out, *words, "--config-dir", str(extra), jobs=2) == 1
    found = statuses(out)
    assert len(found) == 6
    for name, status in found.items():
        assert status == ("failed" if "how=die" in name else "done"), name
    record = record_of(out / "deadly-previous-how=die")
    assert record["status"] == "failed"
    assert record["reason"].startswith("backend=deadly: the process died: signal 9 (SIGKILL")
    assert "3 of 6 runs failed" in capsys.readouterr().err


def test_random_gap_of_a_failed_run_says_so(tmp_path: Path, extra: Path) -> None:
    out = tmp_path / "out"
    words = ("backend=deadly", "backend.how=raise", "selector=rbtm,random_gap")
    assert compare(out, *words, "--config-dir", str(extra)) == 1
    assert statuses(out) == {"deadly-rbtm": "failed", "deadly-random_gap": "failed"}
    assert "steps.parquet" in record_of(out / "deadly-random_gap")["reason"]


def test_an_earlier_result_never_stands_for_a_failed_run(tmp_path: Path, extra: Path) -> None:
    out = tmp_path / "out"
    good = out / "refuses-previous"
    assert main(["run", "dataset.scans=5", "backend=none", "pin=false", f"out='{good}'"]) == 0
    words = ("backend=refuses,none", "selector=previous", "overwrite=true")
    assert compare(out, *words, "--config-dir", str(extra)) == 1
    assert statuses(out)["refuses-previous"] == "failed"
    assert not (good / "metrics.json").exists()


# --- before anything runs


def test_an_existing_folder_is_refused(done: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (done / "table.csv").read_bytes()
    assert compare(done, "backend=none", "selector=previous") == 2
    assert "overwrite=true" in capsys.readouterr().err
    assert (done / "table.csv").read_bytes() == before


def test_overwriting(tmp_path: Path) -> None:
    for _ in range(2):
        assert compare(tmp_path, "backend=none", "selector=previous", "overwrite=true") == 0
    assert statuses(tmp_path) == {"none-previous": "done"}


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("dataset=carmen dataset.path=nowhere.clf", "nowhere.clf"),
        ("selector=rbtm similarity=virtual_scan", "virtual_scan"),
        ("selector=previous,rbtm selector.window=1", "selector.window=1"),
        ("guess=odometry dataset=cloud_folder dataset.path=nowhere", "nowhere"),
        ("--jobs 0", "--jobs 0"),
    ],
)
def test_no_folder_where_settings_or_data_are_at_fault(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: str, named: str
) -> None:
    out = tmp_path / "out"
    assert main(["compare", "backend=none", "pin=false", f"out='{out}'", *words.split()]) == 2
    assert not out.exists()
    error = capsys.readouterr().err
    assert named in error and len(error.splitlines()) == 1


def test_check_data_opens_every_data_set(tmp_path: Path) -> None:
    log = tmp_path / "bad.clf"
    log.write_text("FLASER 180 1 2 3\n")
    for words in (
        ["dataset=carmen", f"dataset.path='{log}'"],
        ["dataset.path_length=1.0,1000.0"],
    ):
        points, _ = make_points(["backend=none", *words])
        with pytest.raises((DataError, ConfigError)):
            one_run.check_data(points)


def test_jobs_by_default_are_the_cores_of_this_process() -> None:
    code = (
        "import os; os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:1]);"
        "from rbtm_bench.engine.drive import default_jobs; print(default_jobs())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "1", done.stderr
    assert drive.default_jobs() == len(os.sched_getaffinity(0))


def test_a_launcher_of_hydra_s_is_refused_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", "seed=0,1", "hydra/launcher=joblib"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and lines[0].startswith("rbtm-bench: hydra/launcher=joblib: ")
    assert "rbtm-bench sweep" in lines[0]
