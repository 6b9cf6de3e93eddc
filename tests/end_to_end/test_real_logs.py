"""Real logs through the command line; numbers checked against arithmetic of their own."""

from __future__ import annotations

import gzip
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from rbtm_bench.cli.commands import main
from rbtm_bench.core.trajectory import Trajectory

SCANS = 300


def words_of(log: Path, out: Path, *more: str) -> list[str]:
    return ["dataset=carmen", f"dataset.path='{log}'", "pin=false", f"out='{out}'", *more]


@pytest.fixture(scope="module")
def aces(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, pd.DataFrame]:
    """The beginning of the ACES log, compared: the folder and its table by run."""
    out = tmp_path_factory.mktemp("aces") / "out"
    log = data_dir / "freiburg" / "aces.clf.gz"
    relations = f"dataset.relations='{log.with_name('aces.relations')}'"
    words = words_of(log, out, relations, f"dataset.max_scans={SCANS}", "--jobs", "1")
    grid = ["backend=none,open3d_p2p", "selector=previous,rbtm", "controls=none"]
    assert main(["compare", *words, *grid]) == 0
    return out, pd.read_csv(out / "table.csv").set_index("run")


def raw_poses(log: Path) -> list[tuple[float, float, float, float]]:
    """(stamp, x, y, theta) of the first FLASER lines, read by hand."""
    poses = []
    with gzip.open(log, "rt") as file:
        for line in file:
            if line.startswith("FLASER") and len(poses) < SCANS:
                words = line.split()
                x, y, theta = map(float, words[-9:-6])
                poses.append((float(words[-3]), x, y, theta))
    return poses


def between(a: Any, b: Any) -> tuple[float, float, float]:
    """The planar motion from pose ``a`` to pose ``b`` (x, y, theta), in the frame of ``a``."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    c, s = math.cos(a[2]), math.sin(a[2])
    return (c * dx + s * dy, -s * dx + c * dy, math.remainder(b[2] - a[2], math.tau))


def test_every_run_has_relations_and_no_truth(aces: tuple[Path, pd.DataFrame]) -> None:
    _, table = aces
    assert len(table) == 4 and set(table["status"]) == {"done"}
    assert (table["scans"] == SCANS).all() and (table["relations_total"] == 1279).all()
    assert (table["relations_used"] > 0).all() and table["relations_used"].nunique() == 1
    assert (table["relations_used"] < table["relations_total"]).all()  # a log cut short
    assert table["ape_rmse_m"].isna().all() and table["final_along_mm"].isna().all()


def test_the_baseline_is_what_the_raw_poses_give(
    aces: tuple[Path, pd.DataFrame], data_dir: Path
) -> None:
    _, table = aces
    folder = data_dir / "freiburg"
    poses = {stamp: pose for stamp, *pose in raw_poses(folder / "aces.clf.gz")}
    translation, rotation = [], []
    for line in (folder / "aces.relations").read_text().splitlines():
        words = [float(word) for word in line.split()]
        if len(words) == 8 and words[0] in poses and words[1] in poses:
            known = (words[2], words[3], words[7])
            error = between(known, between(poses[words[0]], poses[words[1]]))
            translation.append(math.hypot(*error[:2]))
            rotation.append(abs(math.degrees(error[2])))
    row = table.loc["none-previous"]
    assert row["relations_used"] == len(translation) > 10
    assert row["relations_translation_mean_m"] == pytest.approx(np.mean(translation), abs=1e-9)
    assert row["relations_translation_std_m"] == pytest.approx(np.std(translation), abs=1e-9)
    assert row["relations_rotation_mean_deg"] == pytest.approx(np.mean(rotation), abs=1e-6)
    assert row["relations_rotation_std_deg"] == pytest.approx(np.std(rotation), abs=1e-6)


def test_the_baseline_trajectory_is_the_odometry(
    aces: tuple[Path, pd.DataFrame], data_dir: Path
) -> None:
    out, _ = aces
    raw = raw_poses(data_dir / "freiburg" / "aces.clf.gz")
    expected = [between(raw[0][1:], pose[1:]) for pose in raw]
    for run in ("none-previous", "none-rbtm"):  # whatever the model scan, none adds nothing
        estimate = Trajectory.read_tum(out / run / "trajectory.tum")
        assert np.allclose(estimate.stamps, [pose[0] for pose in raw], atol=0)
        assert np.allclose(estimate.T_world_scan[:, :2, 3], np.array(expected)[:, :2], atol=1e-9)


def test_rbtm_really_chooses(aces: tuple[Path, pd.DataFrame]) -> None:
    _, table = aces
    assert (table.loc[["none-previous", "open3d_p2p-previous"], "mean_gap"] == 1).all()
    assert (table.loc[["none-rbtm", "open3d_p2p-rbtm"], "mean_gap"] > 2).all()
    registered = table.loc["open3d_p2p-previous", "relations_rotation_mean_deg"]
    assert registered < 0.5 * table.loc["none-previous", "relations_rotation_mean_deg"]


def test_a_corrected_log_has_a_truth_that_is_not_its_odometry(
    data_dir: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    log = data_dir / "corrected" / "intel-corrected.log.gz"
    words = words_of(log, out, "dataset.max_scans=200", "backend=none", "selector=previous")
    assert main(["run", *words]) == 0
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["ape_rmse_m"] > 0.5
    assert metrics["final_translation_error_mm"] > 500
    assert metrics["relations_used"] is None
    estimate = Trajectory.read_tum(out / "trajectory.tum")
    truth = Trajectory.read_tum(out / "ground_truth.tum")
    assert len(estimate) == len(truth) == 200
    apart = np.linalg.norm(estimate.T_world_scan[-1, :2, 3] - truth.T_world_scan[-1, :2, 3])
    assert apart > 0.5


def test_a_log_without_odometry_says_what_to_do(
    data_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = data_dir / "corrected" / "orebro-corrected.log.gz"
    assert main(["run", *words_of(log, tmp_path / "out", "backend=none")]) == 2
    error = capsys.readouterr().err
    assert "guess=constant_velocity" in error and len(error.splitlines()) == 1
    assert not (tmp_path / "out").exists()
    words = words_of(log, tmp_path / "out", "guess=constant_velocity", "dataset.max_scans=30")
    assert main(["run", *words, "backend=none"]) == 0
