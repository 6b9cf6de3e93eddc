"""A run's numbers against evo's command line and KISS-ICP's functions, from the files it leaves."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.runs import experiment
from rbtm_bench.runs.settings import compose_settings


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that follows noisy wheel odometry around a corner."""
    out = tmp_path_factory.mktemp("agreement") / "run"
    words = ["backend=none", "selector=previous", "guess=odometry", "dataset.environment=l_turn"]
    words += ["dataset.scans=80", "dataset.beams=41", "pin=false", "pictures=false"]
    words += ["dataset.odometry_noise_rotation_deg=1", "metrics.rpe.delta=4"]
    experiment.run(compose_settings(words), out)
    return out


def evo(folder: Path, home: Path, tool: str, *options: str) -> dict[str, float]:
    """The statistics that evo's command line saves. It writes settings into the home directory."""
    from evo.tools.file_interface import load_res_file

    home.mkdir()
    command = [str(Path(sys.executable).with_name(tool)), "tum"]
    command += [str(folder / "ground_truth.tum"), str(folder / "trajectory.tum"), *options]
    command += ["--save_results", str(home / "result.zip"), "--silent"]
    environment = {"HOME": str(home), "MPLBACKEND": "Agg"}
    subprocess.run(command, check=True, cwd=home, env=environment, timeout=120)
    stats: dict[str, float] = load_res_file(home / "result.zip").stats
    return stats


def metrics(folder: Path) -> dict[str, Any]:
    values: dict[str, Any] = json.loads((folder / "metrics.json").read_text())
    return values


def test_ape_is_evo_ape_s(folder: Path, tmp_path: Path) -> None:
    values = metrics(folder)
    stats = evo(folder, tmp_path / "origin", "evo_ape", "--align_origin")
    assert stats["rmse"] > 0.05  # not a comparison of nothing with nothing
    for name in ("rmse", "mean", "max"):
        assert values[f"ape_{name}_m"] == pytest.approx(stats[name], rel=1e-9)
    stats = evo(folder, tmp_path / "fitted", "evo_ape", "--align")
    assert values["ate_translation_m"] == pytest.approx(stats["rmse"], rel=1e-5)
    stats = evo(folder, tmp_path / "angle", "evo_ape", "--align", "-r", "angle_deg")
    assert values["ate_rotation_deg"] == pytest.approx(stats["rmse"], rel=1e-4)


@pytest.mark.parametrize(
    ("relation", "key"),
    [("trans_part", "rpe_translation_rmse_m"), ("angle_deg", "rpe_rotation_rmse_deg")],
)
def test_rpe_is_evo_rpe_s(folder: Path, tmp_path: Path, relation: str, key: str) -> None:
    stats = evo(folder, tmp_path / "rpe", "evo_rpe", "--delta", "4", "--pose_relation", relation)
    assert stats["rmse"] > 0.005
    assert metrics(folder)[key] == pytest.approx(stats["rmse"], rel=1e-6)


def test_kitti_is_kiss_icp_s(folder: Path) -> None:
    """From the same files, once as they are (too short for segments) and once made longer."""
    from kiss_icp.metrics import absolute_trajectory_error, sequence_error

    from rbtm_bench.metrics.kitti import KittiErrors

    truth, estimate = (
        Trajectory.read_tum(folder / name) for name in ("ground_truth.tum", "trajectory.tum")
    )
    values = metrics(folder)
    angle, distance = absolute_trajectory_error(truth.T_world_scan, estimate.T_world_scan)
    assert values["ate_translation_m"] == pytest.approx(distance, rel=1e-5)
    assert values["ate_rotation_deg"] == pytest.approx(57.29577951 * angle, rel=1e-5)
    assert values["kitti_translation_percent"] is values["kitti_rotation_deg_per_m"] is None
    for trajectory in (truth, estimate):
        trajectory.T_world_scan[:, :3, 3] *= 100.0
    percent, deg_per_m = sequence_error(truth.T_world_scan, estimate.T_world_scan)
    assert percent > 0 and deg_per_m > 0
    longer = KittiErrors().evaluate(estimate, truth)
    assert longer["kitti_translation_percent"] == pytest.approx(percent, rel=1e-6)
    assert longer["kitti_rotation_deg_per_m"] == pytest.approx(deg_per_m, rel=1e-6)
