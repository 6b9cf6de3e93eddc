"""One run: its files, what they hold, what it refuses, and what a failure leaves behind."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from rbtm_bench.cli.commands import main
from rbtm_bench.core.errors import ConfigError, RunError
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.metrics.ape import Ape
from rbtm_bench.metrics.final_pose import FinalPose
from rbtm_bench.metrics.kitti import KittiErrors
from rbtm_bench.metrics.relations import RelationError
from rbtm_bench.metrics.rpe import Rpe
from rbtm_bench.metrics.summary import COLUMNS
from rbtm_bench.runs import experiment, pictures
from rbtm_bench.runs.claim import refuse_existing
from rbtm_bench.runs.evaluation import COMMON
from rbtm_bench.runs.looped import FILES as LOOP_FILES
from rbtm_bench.runs.settings import Settings, compose_settings
from rbtm_bench.similarity.curvature_circular import CurvatureCircular

STEP_COLUMNS = {
    *("scan", "stamp", "model", "gap", "score", "candidates", "rejected", "status", "converged"),
    *("fitness", "inlier_rmse_m", "iterations"),
    *("t_prepare_s", "t_describe_s", "t_select_s", "t_register_s"),
}

PLUGINS = '''
from rbtm_bench.backends.base import Alignment, Backend
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.core.errors import DataError

ERRORS = {
    "runtime": RuntimeError("out of\\nluck"),
    "interrupt": KeyboardInterrupt(),
    "silent": RuntimeError(),
}


class Fails(Backend):
    """Fails at the 5th scan: while it is prepared, or while it is registered."""

    def __init__(self, how: str = "runtime", where: str = "build") -> None:
        super().__init__()
        self.how, self.where, self.calls = how, where, 0

    def build(self, points, planar):
        self.calls += 1
        if self.calls == 5 and self.where == "build":
            raise ERRORS[self.how]

    def align(self, source, target, T_target_source):
        if self.calls == 5 and self.where == "align":
            raise ERRORS[self.how]
        return Alignment(T_target_source)


class Refuses(Fails):
    def __init__(self) -> None:
        raise ValueError("no licence found")


class Lacks(Fails):
    def __init__(self) -> None:
        import a_library_that_is_not_there


class Truncated(Corridor):
    """A data set whose 3rd scan turns out to be malformed."""

    def __init__(self) -> None:
        super().__init__(scans=5, beams=61)

    def __getitem__(self, index):
        if index == 2:
            raise DataError("scan.npy: truncated")
        return super().__getitem__(index)
'''

MEMBERS = {
    "backend/fails": "_target_: failing_plugins.Fails\nhow: runtime\nwhere: build",
    "backend/refuses": "_target_: failing_plugins.Refuses",
    "backend/lacks": "_target_: failing_plugins.Lacks",
    "dataset/truncated": "_target_: failing_plugins.Truncated",
}


@pytest.fixture
def extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Configs of plug-ins that fail."""
    (tmp_path / "failing_plugins.py").write_text(PLUGINS)
    configs = tmp_path / "failing_configs"
    for name, text in MEMBERS.items():
        file = configs / f"{name}.yaml"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    return configs


def run(out: Path, *words: str) -> int:
    """Exit code of a small run by the command line, in this process and not pinned."""
    small = [] if any(w.startswith("dataset") for w in words) else ["dataset.scans=12"]
    return main(["run", *small, "pin=false", f"out='{out}'", *words])


def record_of(out: Path) -> dict[str, Any]:
    value = json.loads((out / "run.json").read_text())
    assert isinstance(value, dict)
    return value


def steps_of(out: Path) -> dict[str, list[Any]]:
    return dict(pq.read_table(out / "steps.parquet").to_pydict())


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of rbtm over 20 scans."""
    out = tmp_path_factory.mktemp("experiment") / "a run"
    words = ["dataset.scans=20", "selector.window=6", "selector.threshold=0.2", "seed=4"]
    assert run(out, "backend=none", *words) == 0
    return out


# --- the files of a run

ABSENT = {"relations.parquet", COMMON, *LOOP_FILES}
"""No relations, no replicates, no loops."""


def test_files_of_a_run(done: Path) -> None:
    expected = set(experiment.FILES) - ABSENT
    assert {p.name for p in done.iterdir()} == expected


def test_no_scores_no_similarity_file(tmp_path: Path) -> None:
    assert run(tmp_path, "backend=none", "selector=previous") == 0
    expected = set(experiment.FILES) - ABSENT - {"similarity.npz"}
    assert {p.name for p in tmp_path.iterdir()} == expected


def test_steps_have_a_row_a_scan(done: Path) -> None:
    steps = steps_of(done)
    assert set(steps) >= STEP_COLUMNS
    assert steps["scan"] == list(range(20))
    assert steps["stamp"] == pytest.approx([0.1 * i for i in range(20)])
    assert steps["status"][0] == "first" and set(steps["status"][1:]) <= {"registered", "fallback"}
    assert steps["model"][0] is None and steps["gap"][0] is None and steps["score"][0] is None
    for scan, model, gap, status in zip(
        *(steps[k][1:] for k in ("scan", "model", "gap", "status")), strict=True
    ):
        assert gap == scan - model and 1 <= gap <= 5
        assert status == "registered" or gap == 1
    assert max(steps["gap"][1:]) == 5, "the threshold was too high to show anything"
    for column in ("t_prepare_s", "t_describe_s", "t_select_s", "t_register_s"):
        assert all(t >= 0 for t in steps[column]) and sum(steps[column]) > 0
    assert steps["iterations"][1:] == [0] * 19  # backend=none
    assert steps["converged"][1:] == [None] * 19  # not said is not false


def test_trajectory_and_truth(done: Path) -> None:
    estimate = Trajectory.read_tum(done / "trajectory.tum")
    truth = Trajectory.read_tum(done / "ground_truth.tum")
    assert len(estimate) == len(truth) == 20
    assert np.array_equal(estimate.stamps, truth.stamps)
    assert np.array_equal(estimate.T_world_scan[0], np.eye(4))
    expected = Corridor(scans=20, seed=4).ground_truth
    assert np.allclose(truth.T_world_scan, expected, atol=1e-12)


def test_metrics_have_every_key_and_nothing_made_up(done: Path) -> None:
    metrics = json.loads((done / "metrics.json").read_text())
    families = (FinalPose, Ape, Rpe, KittiErrors, RelationError)
    assert set(metrics) == set(COLUMNS).union(*(family.columns for family in families))
    assert all(metrics[key] is None for key in RelationError.columns)  # no relations: not 0
    steps = steps_of(done)
    assert metrics["mean_gap"] == pytest.approx(np.mean(steps["gap"][1:]))
    assert metrics["fallbacks"] == steps["status"].count("fallback")
    assert metrics["coverage"] == 1.0


def test_record_tells_where_numbers_come_from(done: Path) -> None:
    record = record_of(done)
    assert (record["status"], record["reason"]) == ("done", None)
    assert record["started"] <= record["finished"] and record["seconds"] > 0
    assert record["choices"]["backend"] == "none" and record["seed"] == 4
    assert "seed=4" in record["overrides"]
    assert (record["scans"], record["skipped_records"]) == (20, 0)
    assert record["dataset_fingerprint"] == Corridor(scans=20, seed=4).fingerprint()
    assert {"rbtm_bench", "python", "numpy", "open3d", "kiss-icp"} <= set(record["versions"])
    assert {"command", "git", "host", "machine", "core"} <= set(record)
    assert record["core"] is None  # pin=false


def test_map_and_similarity(done: Path) -> None:
    points = np.load(done / "map.npz")["points"]
    assert points.dtype == np.float32 and points.shape[1] == 3 and len(points) > 100
    cells = np.floor(points.astype(float) / 0.05).astype(int)
    assert len(np.unique(cells, axis=0)) > 0.99 * len(points)  # float32 may cross a border
    grid = np.load(done / "map.npz")
    assert float(grid["cell"]) == 0.05 and grid["hits"].max() <= 20
    columns, rows = np.floor((points[:, :2] - grid["corner"]) / 0.05).astype(int).T
    assert np.mean(grid["hits"][rows, columns] > 0) > 0.99  # float32 may cross a border
    similarity = np.load(done / "similarity.npz")
    assert np.array_equal(similarity["scans"], np.arange(20))
    assert similarity["scores"].shape == (20, 20)
    assert np.allclose(np.diag(similarity["scores"]), 1.0)


def test_similarity_picture_of_a_long_run_is_thinned() -> None:
    dataset = Corridor(scans=400, beams=61)
    scans, scores = pictures.similarity_matrix(dataset, CurvatureCircular(half_span_deg=8.0))
    assert len(scans) == pictures.SIMILARITY_PICTURE
    assert (scans[0], scans[-1]) == (0, 399) and (np.diff(scans) > 0).all()
    assert scores.shape == (len(scans), len(scans))


def test_config_is_enough_to_run_the_same_again(done: Path, tmp_path: Path) -> None:
    config = yaml.safe_load((done / "config.yaml").read_text())
    assert "${" not in (done / "config.yaml").read_text()
    experiment.run(Settings(config, record_of(done)["choices"]), tmp_path)
    for name in ("trajectory.tum", "ground_truth.tum", "config.yaml"):
        assert (tmp_path / name).read_bytes() == (done / name).read_bytes()


def test_progress_is_told_after_every_scan(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    settings = compose_settings(["dataset.scans=4", "backend=none", "pin=false"])
    experiment.run(settings, tmp_path, lambda done, total: seen.append((done, total)))
    assert seen == [(1, 4), (2, 4), (3, 4), (4, 4)]


# --- existing folders


def test_an_existing_folder_is_refused(
    done: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {p.name: p.read_bytes() for p in done.iterdir()}
    assert run(done, "backend=none", "seed=9") == 2
    error = capsys.readouterr().err
    assert str(done) in error and "overwrite=true" in error and len(error.splitlines()) == 1
    assert {p.name: p.read_bytes() for p in done.iterdir()} == before
    (tmp_path / "a file").touch()
    assert run(tmp_path / "a file", "backend=none") == 2
    assert run(tmp_path / "a file" / "below", "backend=none") == 2
    assert run(tmp_path / "a file", "backend=none", "overwrite=true") == 2
    (tmp_path / "empty").mkdir()
    assert run(tmp_path / "empty", "backend=none") == 0


def test_overwriting_leaves_nothing_of_the_earlier_run(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    assert run(tmp_path, "backend=none", "overwrite=true") == 0
    assert (tmp_path / "similarity.npz").exists()
    assert run(tmp_path, "backend=none", "selector=previous", "overwrite=true") == 0
    assert not (tmp_path / "similarity.npz").exists()
    assert record_of(tmp_path)["choices"]["selector"] == "previous"
    assert (tmp_path / "notes.txt").read_text() == "mine"


# --- failures


def failed(out: Path) -> dict[str, Any]:
    """The record of a failed run; asserts that no result is there."""
    record = record_of(out)
    assert record["status"] == "failed" and record["finished"]
    assert {p.name for p in out.iterdir()} == {"config.yaml", "run.json"}
    return record


def test_a_backend_that_raises_midway(
    tmp_path: Path, extra: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert run(out, "backend=fails", "--config-dir", str(extra)) == 1
    error = capsys.readouterr().err
    assert error == "rbtm-bench: RuntimeError: out of luck (--debug shows where)\n"
    record = failed(out)
    assert record["reason"] == "backend=fails: RuntimeError: out of luck"
    assert "Traceback" in record["traceback"] and record["scans"] == 12
    assert run(out, "backend=fails", "--config-dir", str(extra)) == 2  # refused, not overwritten
    words = ("backend=fails", "backend.how=silent", "overwrite=true", "--config-dir", str(extra))
    assert run(out, *words) == 1
    assert failed(out)["reason"] == "backend=fails: RuntimeError"


def test_an_interrupted_run(tmp_path: Path, extra: Path) -> None:
    out = tmp_path / "out"
    words = ("backend=fails", "backend.how=interrupt", "--config-dir", str(extra))
    assert run(out, *words) == 130
    assert "KeyboardInterrupt" in failed(out)["reason"]


def test_a_registration_that_raises_is_a_rejected_candidate(tmp_path: Path, extra: Path) -> None:
    out = tmp_path / "out"
    words = ("backend=fails", "backend.where=align", "selector=previous")
    assert run(out, *words, "--config-dir", str(extra)) == 0
    steps = steps_of(out)
    assert steps["rejected"] == [0, 0, 0, 0, 1, *[0] * 7]
    assert steps["status"][4] == "predicted" and "out of" in steps["reason"][4]
    assert steps["model"][4] is None and steps["fitness"][4] is None


def test_data_that_turn_out_to_be_malformed(tmp_path: Path, extra: Path) -> None:
    out = tmp_path / "out"
    words = ("dataset=truncated", "backend=none", "--config-dir", str(extra))
    assert run(out, *words) == 2
    assert failed(out)["reason"] == "scan.npy: truncated"


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("selector.window=0", "selector.window=0"),
        ("dataset=carmen dataset.path=nowhere.clf", "nowhere.clf"),
        ("dataset.scans=4 dataset.path_length=1000", "path_length=1000"),
        ("dataset.scans=4 similarity=virtual_scan", "virtual_scan"),
        ("selector=random_gap", "random_gap"),
        ("selector=random_gap selector.gaps_from=nowhere", "gaps_from=nowhere"),
        ("backend=refuses", "no licence found"),
        ("backend=lacks", "rbtm-bench doctor"),
    ],
)
def test_no_folder_where_settings_or_data_are_at_fault(
    tmp_path: Path, extra: Path, capsys: pytest.CaptureFixture[str], words: str, named: str
) -> None:
    assert run(tmp_path / "out", *words.split(), "--config-dir", str(extra)) == 2
    assert not (tmp_path / "out").exists()
    error = capsys.readouterr().err
    assert named in error and len(error.splitlines()) == 1


def test_a_file_that_cannot_be_finished_is_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def half(file: Any, **arrays: Any) -> None:
        file.write(b"half a")
        raise OSError("No space left on device")

    monkeypatch.setattr(np, "savez_compressed", half)
    assert run(tmp_path / "out", "backend=none") == 1
    assert record_of(tmp_path / "out")["status"] == "failed"
    written = {p.name for p in (tmp_path / "out").iterdir()}
    assert "steps.parquet" in written and "map.npz" not in written
    assert not [name for name in written if "partial" in name]


def test_reasons_are_one_line() -> None:
    assert experiment.reason(RunError("a\n b")) == "a b"
    assert experiment.reason(ValueError("a\n b")) == "ValueError: a b"
    with pytest.raises(ConfigError, match="already holds files"):
        refuse_existing(Path(__file__).parent, overwrite=False)


# --- the same bits


def bits(out: Path) -> tuple[bytes, dict[str, list[Any]]]:
    steps = {k: str(v) for k, v in steps_of(out).items() if not k.startswith("t_")}
    return (out / "trajectory.tum").read_bytes(), steps


@pytest.mark.slow
def test_same_settings_same_bits_serial_parallel_and_in_another_process(tmp_path: Path) -> None:
    def call(*words: str) -> None:
        command = [sys.executable, "-m", "rbtm_bench", *words, "dataset.scans=15"]
        env = {**os.environ, "TMPDIR": str(tmp_path)}
        done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr

    grid = ["backend=open3d_p2p,open3d_p2plane", "selector=rbtm,random_gap", "controls=none"]
    call("compare", *grid, "selector.threshold=0.2", "out=serial", "--jobs", "1")
    call("compare", *grid, "selector.threshold=0.2", "out=parallel", "--jobs", "2")
    call("run", "backend=open3d_p2plane", "selector.threshold=0.2", "out=alone")
    names = sorted(p.parent.name for p in (tmp_path / "serial").glob("*/run.json"))
    assert len(names) == 4
    for name in names:
        assert bits(tmp_path / "serial" / name) == bits(tmp_path / "parallel" / name), name
    assert bits(tmp_path / "serial" / "open3d_p2plane-rbtm") == bits(tmp_path / "alone")
