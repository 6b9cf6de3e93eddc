"""The shipped experiments: each composes, passes the checks, and says what it does."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import pytest

from rbtm_bench.cli.commands import main
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.engine.hydra_sweep import SweepPlan
from rbtm_bench.runs.settings import compose_settings, config_dir

FOLDER = config_dir() / "experiment"
EXPERIMENTS = sorted(path.stem for path in FOLDER.glob("*.yaml"))
JOBS = {
    "aces_backends": 20,
    "best_2d": 1,
    "best_3d": 1,
    "corridor_grid": 84,
    "overnight": 1800,
    "overnight_controls": 1800,
    "table1": 100,
}
NEEDED = {"aces_backends": ["dataset.path=aces.clf.gz"]}
"""What an experiment leaves to its user."""


def plan(name: str, *words: str) -> SweepPlan:
    return SweepPlan.of([f"+experiment={name}", *NEEDED.get(name, []), *words], ())


def rows(out: Path) -> list[dict[str, str]]:
    with open(out / "table.csv", newline="") as file:
        return list(csv.DictReader(file))


def test_the_experiments_are_known_here() -> None:
    assert sorted(JOBS) == EXPERIMENTS


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_value_of_an_experiment_is_checked(name: str) -> None:
    found = plan(name)
    assert found.jobs is not None
    assert len(found.jobs) == len({tuple(job) for job in found.jobs}) == JOBS[name]
    text = (FOLDER / f"{name}.yaml").read_text()
    counts = re.findall(r"(\d+) runs", text)
    assert all(int(count) == JOBS[name] for count in counts)


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_job_of_an_experiment_composes(name: str) -> None:
    jobs = plan(name).jobs
    assert jobs is not None
    step = max(1, len(jobs) // 8)
    for job in jobs[::step]:
        compose_settings(job)


def test_table1_has_a_row_for_every_way_with_settings_of_its_own() -> None:
    members = sorted(path.stem for path in (FOLDER / "table1").glob("*.yaml"))
    points = plan("table1").settings
    found = {point.choices["selector"]: point.config["selector"] for point in points}
    assert sorted(found) == members
    assert found["rbtm"]["window"] == 64 and found["rbtm"]["threshold"] == 0.5
    assert found["fixed_gap"]["gap"] == 40 and found["oldest"]["window"] == 32


def test_aces_backends_wants_a_log() -> None:
    with pytest.raises(ConfigError, match=r"^dataset\.path is not set"):
        SweepPlan.of(["+experiment=aces_backends"], ())


def test_an_unknown_experiment_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sweep", "+experiment=table"]) == 2
    err = capsys.readouterr().err
    assert err.startswith("rbtm-bench: experiment=table: no such experiment. Did you mean table1?")
    assert err.count("\n") == 1


def test_words_replace_an_experiments_lists() -> None:
    jobs = plan("corridor_grid", "selector.window=8", "seed=3").jobs
    assert jobs is not None and len(jobs) == 7
    settings = compose_settings(jobs[0])
    assert settings.config["selector"]["window"] == 8 and settings.config["seed"] == 3


def test_a_wrong_value_stops_an_experiment() -> None:
    with pytest.raises(ConfigError, match=r"^selector\.window=1:"):
        plan("corridor_grid", "selector.window=8,1")


@pytest.mark.slow
def test_an_experiment_runs_and_goes_on(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["backend=none,open3d_p2p", "seed=5", "dataset.scans=8"]
    assert main(["sweep", "+experiment=table1", *words, f"out={out}"]) == 0
    first = rows(out)
    assert [(row["backend"], row["selector"]) for row in first] == [
        (backend, selector)
        for backend in ("none", "open3d_p2p")
        for selector in ("previous", "keyframe", "fixed_gap", "oldest", "rbtm")
    ]
    (out / "7" / "metrics.json").unlink()
    before = (out / "6" / "run.json").stat().st_mtime_ns
    assert main(["sweep", "--resume", str(out)]) == 0
    assert (out / "6" / "run.json").stat().st_mtime_ns == before
    key = "final_translation_error_mm"
    assert [row[key] for row in rows(out)] == [row[key] for row in first]


# --- values that move together


ZIPPED = [
    "+point={window:4,threshold:0.9},{window:16,threshold:0.8}",
    "selector.window=${point.window}",
    "selector.threshold=${point.threshold}",
]


@pytest.mark.slow
def test_zipped_values_move_together(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = [*ZIPPED, "seed=0,1,2", "backend=none", "dataset.scans=8"]
    assert main(["sweep", *words, f"out={out}"]) == 0
    found = [(int(r["window"]), float(r["threshold"]), int(r["seed"])) for r in rows(out)]
    assert found == [(w, t, s) for w, t in ((4, 0.9), (16, 0.8)) for s in (0, 1, 2)]


def test_zipped_values_are_checked() -> None:
    points = "+point={window:4,threshold:0.9},{window:16,threshold:1.8}"
    with pytest.raises(ConfigError, match=r"^selector\.threshold=1\.8:"):
        SweepPlan.of([points, *ZIPPED[1:]], ())


def test_zipped_values_must_all_be_there() -> None:
    with pytest.raises(ConfigError, match="window"):
        SweepPlan.of(["+point={threshold:0.9},{window:16}", *ZIPPED[1:]], ())
