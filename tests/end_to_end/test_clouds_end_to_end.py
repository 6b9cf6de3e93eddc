"""From simulated clouds on disk to a table: the 3D side, through the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from cloud_helpers import write_hall

from rbtm_bench.cli.commands import main
from rbtm_bench.core.trajectory import Trajectory

SCANS, STEP = 16, 0.15
PATH_MM = 1e3 * STEP * (SCANS - 1)


@pytest.fixture(scope="module", params=["npy", "ply"])
def clouds(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of clouds and their poses, in one of the formats."""
    folder = tmp_path_factory.mktemp("clouds") / f"{request.param} clouds"
    write_hall(folder, SCANS, STEP, suffix=request.param)
    assert len(list(folder.glob(f"*.{request.param}"))) == SCANS
    return folder


@pytest.fixture(scope="module")
def compared(clouds: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two backends with rbtm and everything else as cloud_folder has it."""
    out = tmp_path_factory.mktemp("compared") / "out"
    words = ["dataset=cloud_folder", f"dataset.path='{clouds}'", "pin=false", f"out='{out}'"]
    poses = f"dataset.poses='{clouds / 'poses.tum'}'"
    grid = [
        "backend=open3d_p2plane,kiss_icp",
        "selector=rbtm",
        "selector.threshold=0.5",
        "controls=none",
    ]
    assert main(["compare", *words, poses, *grid, "--jobs", "1"]) == 0
    return out


def test_rbtm_chooses_by_virtual_scans(compared: Path) -> None:
    for run in ("open3d_p2plane-rbtm", "kiss_icp-rbtm"):
        record = json.loads((compared / run / "run.json").read_text())
        assert record["choices"]["similarity"] == "virtual_scan"
        assert record["choices"]["guess"] == "constant_velocity"
        assert record["scans"] == SCANS
        steps = pq.read_table(compared / run / "steps.parquet").to_pydict()
        assert max(gap for gap in steps["gap"] if gap) > 1
        assert steps["status"].count("registered") > SCANS // 2
        assert all(score > 0.5 for score, s in zip(steps["score"], steps["status"], strict=True)
                   if s == "registered")  # fmt: skip


def test_errors_are_small_against_the_path(compared: Path) -> None:
    table = pd.read_csv(compared / "table.csv").set_index("run")
    error = table["final_translation_error_mm"]
    assert error["open3d_p2plane-rbtm"] < 0.05 * PATH_MM
    assert error["kiss_icp-rbtm"] < 0.10 * PATH_MM  # point to point lags behind on the rings
    assert (table["final_rotation_error_deg"] < 2.0).all()
    assert (table["coverage"] == 1.0).all()


def test_truth_is_the_poses_file(clouds: Path, compared: Path) -> None:
    written = Trajectory.read_tum(clouds / "poses.tum")
    truth = Trajectory.read_tum(compared / "kiss_icp-rbtm" / "ground_truth.tum")
    assert np.allclose(truth.T_world_scan, written.T_world_scan, atol=1e-9)
    assert np.array_equal(truth.stamps, written.stamps)
    kept = np.load(compared / "kiss_icp-rbtm" / "map.npz")
    assert np.ptp(kept["points"][:, 2]) > 2.0  # a map in space, not of a plane
    assert "hits" not in kept  # nor an occupancy grid


def test_without_poses_there_is_no_truth_and_no_error(clouds: Path, tmp_path: Path) -> None:
    words = ["dataset=cloud_folder", f"dataset.path='{clouds}'", "dataset.max_scans=3"]
    assert main(["run", *words, "backend=kiss_icp", "pin=false", f"out='{tmp_path}'"]) == 0
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["ape_rmse_m"] is None and metrics["final_translation_error_mm"] is None
    assert not (tmp_path / "ground_truth.tum").exists()


def test_what_does_not_fit_clouds(
    clouds: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    few = tmp_path / "few.tum"
    few.write_text("0 0 0 0 0 0 0 1\n")
    for words, named in (
        (["similarity=curvature_circular"], "virtual_scan"),
        (["guess=odometry"], "needs odometry"),
        ([f"dataset.poses='{few}'"], f"1 poses for {SCANS} clouds"),
        (["dataset.poses=nowhere.tum"], "nowhere.tum"),
        (["dataset.pattern='*.xyz'"], "*.xyz"),
    ):
        given = ["dataset=cloud_folder", f"dataset.path='{clouds}'", "backend=none", "pin=false"]
        assert main(["run", *given, f"out='{tmp_path / 'out'}'", *words]) == 2
        error = capsys.readouterr().err
        assert named in error and len(error.splitlines()) == 1
        assert not (tmp_path / "out").exists()


def test_a_truncated_cloud_is_named(
    clouds: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = sorted(p for p in clouds.iterdir() if p.suffix in (".npy", ".ply"))[0]
    folder = tmp_path / "damaged"
    folder.mkdir()
    for number in range(3):
        content = source.read_bytes()
        half = content[: len(content) // 2] if number == 1 else content
        (folder / f"{number}{source.suffix}").write_bytes(half)
    words = ["dataset=cloud_folder", f"dataset.path='{folder}'", "backend=none", "pin=false"]
    assert main(["run", *words, f"out='{tmp_path / 'out'}'"]) == 2
    error = capsys.readouterr().err
    assert str(folder / f"1{source.suffix}") in error
    assert len([line for line in error.splitlines() if not line.startswith("data: ")]) == 1
