"""Small inputs that are easily read wrongly: each is read rightly, or refused with its reason."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rbtm_bench.cli.commands import main
from rbtm_bench.core.errors import DataError
from rbtm_bench.datasets.carmen import Carmen
from rbtm_bench.datasets.cloud_files import read_points
from rbtm_bench.datasets.cloud_folder import CloudFolder
from rbtm_bench.datasets.kitti import Kitti
from rbtm_bench.datasets.summary import head

RIGHT_MM = 11.21
"""Final error of open3d_gicp on the eight clouds of a hall, in the right order and unit."""
SINGLE = 1e-6
"""m; clouds that are single precision in a file."""


def clouds(cases: Path, name: str, poses: str | None = None, **settings: Any) -> CloudFolder:
    truth = cases / (poses or f"{name}/poses.tum")
    return CloudFolder(str(cases / name / "clouds"), poses=str(truth), **settings)


def log(cases: Path, name: str, **settings: Any) -> Carmen:
    return Carmen(str(cases / name / "log.clf"), str(cases / name / "log.relations"), **settings)


def reading(data: Any, what: str) -> str:
    return next(r.taken for r in data.readings if r.what == what)


# --- clouds


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("pcd_double", {}),
        ("bin_five_floats", {}),
        ("appledouble", {}),
        ("decimal_stamp_names", {}),
        ("millimetres", {"scale": 0.001}),
    ],
)
def test_clouds_are_those_of_the_baseline(
    cases_dir: Path, name: str, settings: dict[str, Any]
) -> None:
    right, data = clouds(cases_dir, "baseline"), clouds(cases_dir, name, **settings)
    assert len(data) == len(right) == 8
    for expected, scan in zip(right, data, strict=True):
        np.testing.assert_allclose(scan.points, expected.points, atol=2 * SINGLE)
        np.testing.assert_array_equal(scan.ground_truth, expected.ground_truth)


def test_a_list_among_the_vertex_properties(cases_dir: Path) -> None:
    data = clouds(cases_dir, "ply_vertex_list")
    assert [len(scan.points) for scan in data] == [800] * 8
    assert data[0].points[0] == pytest.approx([-4.4797, 0.0, -1.2003])


def test_millimetres_are_no_metres(cases_dir: Path) -> None:
    with pytest.raises(
        DataError, match=r"mm \(dataset\.scale=0\.001: 6\.8\d m\).*dataset\.scale=1\)"
    ):
        clouds(cases_dir, "millimetres")


def test_coordinates_of_the_world_are_said_and_keep_their_digits(cases_dir: Path) -> None:
    right, data = clouds(cases_dir, "baseline"), clouds(cases_dir, "utm_world")
    assert reading(data, "frame").startswith("the world's, less (512345, 5403205")
    assert any("coordinates of the world" in text for text in data.suspicions)
    points, expected = data[0].points, right[0].points  # alike but for where they begin
    np.testing.assert_allclose(points - points[0], expected - expected[0], atol=1e-8)


@pytest.mark.parametrize(
    ("folder", "layout"), [("nclt", "nclt"), ("nuscenes5", "nuscenes"), ("boreas6", "boreas")]
)
def test_layouts_of_bare_bytes(cases_dir: Path, folder: str, layout: str) -> None:
    data = CloudFolder(str(cases_dir / "bin_layouts" / folder))
    assert reading(data, "layout").startswith(f"{layout}:")
    points = data[0].points
    assert len(points) == 4000 and np.abs(points).max() < 5 and np.ptp(points[:, 2]) < 0.1
    with pytest.raises(DataError, match="another layout or byte order"):
        CloudFolder(str(cases_dir / "bin_layouts" / "nclt"), layout="kitti")[0]


@pytest.mark.parametrize("name", ["unsorted", "dense100hz", "bom"])
def test_poses_belong_to_clouds_by_time(cases_dir: Path, name: str) -> None:
    right = clouds(cases_dir, "baseline")
    data = clouds(cases_dir, "baseline", f"tum/{name}.tum")
    np.testing.assert_allclose(data.ground_truth, right.ground_truth, atol=1e-12)
    np.testing.assert_allclose(data.stamps, right.stamps)
    assert any("step" in text for text in data.suspicions) == (name == "unsorted")


def test_semantic_kitti(cases_dir: Path, data_dir: Path, tmp_path: Path) -> None:
    """The case's scans are names of those in KITTI's own layout."""
    here = tmp_path / "sequences" / "00"
    shutil.copytree(cases_dir / "kitti_layout" / "semantic" / "sequences" / "00", here)
    (here / "velodyne").chmod(0o755)
    own = data_dir / "kitti" / "sequences" / "00" / "velodyne"
    for file in sorted((here / "velodyne").iterdir()):
        file.unlink()
        file.symlink_to(own / file.name)
    data, right = Kitti(str(tmp_path)), Kitti(str(data_dir / "kitti"), max_scans=6)
    assert len(data) == 6 and data.has_ground_truth
    for a, b in zip(data, right, strict=True):
        np.testing.assert_array_equal(a.points, b.points)
        np.testing.assert_array_equal(a.ground_truth, b.ground_truth)


# --- logs


@pytest.mark.parametrize(
    ("name", "beams", "first", "last"),
    [
        ("c_base", 181, -90, 90),
        ("c_robotlaser1", 181, -90, 90),
        ("c_beams_682", 682, -120, 120),
        ("c_beams_1081", 1081, -135, 135),
        ("c_param_resolution", 181, -45, 45),
    ],
)
def test_angles(cases_dir: Path, name: str, beams: int, first: float, last: float) -> None:
    angles = np.rad2deg(log(cases_dir, name).angles)
    assert len(angles) == beams and angles[[0, -1]] == pytest.approx([first, last], abs=1e-3)


def test_one_glitch_does_not_hide_what_means_no_return(cases_dir: Path) -> None:
    data = log(cases_dir, "c_noreturn_one_glitch")
    assert data.max_range == pytest.approx(81.73)
    assert np.isnan(data.ranges).sum() == 1501
    assert data.dropped() == {"no return": 1501}


@pytest.mark.parametrize("name", ["c_async_odometry", "c_robotlaser1"])
def test_odometry_is_no_truth(cases_dir: Path, name: str) -> None:
    data, right = log(cases_dir, name), log(cases_dir, "c_base")
    assert not data.corrected and not data.has_ground_truth
    np.testing.assert_allclose(data.odometry, right.odometry, atol=1e-12)


def test_truth_is_no_odometry(cases_dir: Path) -> None:
    data, right = log(cases_dir, "c_two_triples_odom"), log(cases_dir, "c_base")
    assert data.corrected and data.has_ground_truth
    np.testing.assert_allclose(data.odometry, right.odometry, atol=1e-12)
    assert data.ground_truth is not None
    assert np.abs(data.ground_truth[-1] - right.odometry[-1]).max() > 0.01  # type: ignore[index]


def test_relations_of_other_times_are_refused(cases_dir: Path) -> None:
    offset = str(cases_dir / "relations" / "offset.relations")
    with pytest.raises(DataError, match=r"none of 10 relations .* 1000003600\.000 to .*scans from"):
        Carmen(str(cases_dir / "c_base" / "log.clf"), offset)


# --- damage


def test_damaged_clouds_are_one_line_and_no_memory(cases_dir: Path) -> None:
    files = [f for f in (cases_dir / "damaged").iterdir() if f.suffix in (".pcd", ".ply", ".npy")]
    assert len(files) == 5
    for file in files:
        with pytest.raises(DataError) as caught:
            read_points(file)
        assert str(file) in str(caught.value) and "\n" not in str(caught.value)


def test_damaged_results_are_one_line(cases_dir: Path, tmp_path: Path) -> None:
    from rbtm_bench.core.bounded import read_json
    from rbtm_bench.plots.folder import _npz

    damaged = cases_dir / "damaged"
    with pytest.raises(DataError, match=r"points \(150000000, 3\) announced, 1128 bytes"):
        _npz(damaged / "rd-memory-npzbomb-20-map.npz", ("points",))
    with pytest.raises(DataError, match="not readable: Error -3"):
        _npz(damaged / "rd-exception-flip-143-similarity.npz", ("scans", "scores"))
    with pytest.raises(DataError, match="not readable as JSON"):
        read_json(damaged / "run-unknown-jsondeep-37-run.json")


# --- runs


def final(words: list[str], out: Path) -> dict[str, Any]:
    common = ["pin=false", "pictures=false", f"out={out}"]
    assert main(["run", *words, *common]) == 0
    metrics: dict[str, Any] = json.loads((out / "metrics.json").read_text())
    run = json.loads((out / "run.json").read_text())
    assert run["readings"] and "dropped_points" in run
    return metrics


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["baseline", "pcd_double", "bin_five_floats", "appledouble", "decimal_stamp_names"]
)
def test_runs_on_clouds(cases_dir: Path, tmp_path: Path, name: str) -> None:
    words = [str(cases_dir / name), "backend=open3d_gicp", "selector=previous"]
    error = final(words, tmp_path / "out")["final_translation_error_mm"]
    assert error == pytest.approx(RIGHT_MM, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "right"),
    [
        ("c_base", 0.0078),
        ("c_robotlaser1", 0.0078),
        ("c_async_odometry", 0.0078),
        ("c_two_triples_odom", 0.0078),
        ("c_noreturn_one_glitch", 0.0070),
        ("c_param_resolution", 0.0020),
        ("c_beams_682", 0.0023),
        ("c_beams_1081", 0.0008),
    ],
)
def test_runs_on_logs(cases_dir: Path, tmp_path: Path, name: str, right: float) -> None:
    words = [str(cases_dir / name), "backend=open3d_p2plane", "selector=keyframe"]
    words += ["selector.distance=0.3"]
    metrics = final(words, tmp_path / "out")
    assert metrics["relations_translation_mean_m"] == pytest.approx(right, abs=1e-4)
    assert metrics["relations_used"] == 10


def test_what_is_decided_is_said_in_a_line_each(cases_dir: Path) -> None:
    lines = head(log(cases_dir, "c_async_odometry"))
    assert "data: truth: none (else corrected=)" in lines
    assert any(line.startswith("data: odometry: poses of FLASER") for line in lines)
    assert all("\n" not in line and line.startswith("data: ") for line in lines)


def test_the_table_has_a_row_a_case(cases_dir: Path) -> None:
    script = Path(__file__).parents[2] / "scripts" / "benchmarks" / "cases.py"
    command = [sys.executable, str(script), str(cases_dir)]
    rows = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    table = dict(row.strip("| ").split(" | ", 1) for row in rows[2:])
    assert table["pcd_double"].startswith("8 scans, 128000 points; truth in order")
    assert table["millimetres"].startswith("refused: millimetres/clouds: half of the points")
    assert "CAUTION the clouds are in coordinates of the world" in table["utm_world"]
    cases = {path.name for path in cases_dir.iterdir() if path.is_dir()}
    assert {name.split("/")[0] for name in table} == cases
