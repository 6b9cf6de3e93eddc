"""``import rbtm_bench as rb``: light, and the same numbers as the command line's."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
import pytest
from sweep_helpers import call

import rbtm_bench as rb
from rbtm_bench.backends.none import NoRegistration
from rbtm_bench.core.errors import BackendError, ConfigError, DataError, RunError
from rbtm_bench.core.geometry import se2, transform
from rbtm_bench.runs.evaluation import checksum

SMALL = {"dataset__scans": 20, "dataset__beams": 181, "pictures": False}


@pytest.fixture(scope="module")
def corridor() -> rb.Dataset:
    return rb.open_dataset(dataset="corridor", dataset__scans=20, dataset__beams=181)


def test_the_import_loads_nothing() -> None:
    code = (
        "import json, sys; import rbtm_bench as rb; assert 'odometry' in dir(rb);"
        "print(json.dumps(sorted(m for m in sys.modules if m.startswith('rbtm_bench.')"
        " or m in ('numpy', 'hydra', 'pandas', 'scipy', 'open3d'))))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert json.loads(done.stdout) == []


def test_every_name_is_there() -> None:
    code = "from rbtm_bench import *; print(callable(odometry), Backend.__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.split() == ["True", "Backend"], done.stderr
    assert set(rb.__all__) <= set(dir(rb)) and all(hasattr(rb, name) for name in rb.__all__)
    with pytest.raises(AttributeError, match="regster"):
        _ = rb.regster  # type: ignore[attr-defined]


# --- register


@pytest.mark.parametrize("backend", ["plicp", "open3d_p2p"])
def test_two_planar_clouds(corridor: rb.Dataset, backend: str) -> None:
    T = se2(0.05, 0.02, 0.03)
    target = corridor[3].points
    source = transform(np.linalg.inv(T), target)
    for a, b in ((source[:, :2], target[:, :2]), (source, target)):
        result = rb.register(a, b, backend)
        np.testing.assert_allclose(result.T_target_source, T, atol=1e-3)
        assert result.fitness == 1.0 and (result.T_target_source[2] == [0, 0, 1, 0]).all()
    assert rb.register(source, target, backend, guess=T).inlier_rmse < 1e-3


def test_clouds_in_space_and_of_open3d() -> None:
    points = np.random.default_rng(0).uniform(-3, 3, (3000, 3))
    T = np.eye(4)
    T[:3, 3] = 0.05, -0.05, 0.1
    clouds = [
        o3d.geometry.PointCloud(o3d.utility.Vector3dVector(p))
        for p in (transform(np.linalg.inv(T), points), points)
    ]
    sizes = {"backend__voxel_size": 0.0, "backend__max_correspondence_distance": 0.5}
    result = rb.register(*clouds, "open3d_p2p", **sizes)
    np.testing.assert_allclose(result.T_target_source, T, atol=1e-6)
    thinned = rb.register(*clouds, "open3d_p2p", registration__voxel_size=1.0)
    assert thinned.inliers < result.inliers  # both ways to say it reach the backend


@pytest.mark.parametrize(
    ("given", "settings", "error", "words"),
    [
        (2, {"windw": 3}, ConfigError, "windw: no such setting"),
        (2, {"selector": "rbtm"}, ConfigError, "selector: no setting of register"),
        (2, {"backend__voxel_siz": 1}, ConfigError, "Did you mean voxel_size"),
        (2, {"backend": "plcp"}, ConfigError, "Did you mean plicp"),
        (2, {"backend": "kiss_icp_system"}, ConfigError, "is a whole odometry"),
        (3, {"backend": "plicp"}, ConfigError, "backend=plicp is for 2d only"),
        (4, {}, DataError, r"\(50, 4\): expected points"),
    ],
)
def test_mistakes(given: int, settings: Any, error: type[Exception], words: str) -> None:
    cloud = np.random.default_rng(0).uniform(-3, 3, (50, given))
    with pytest.raises(error, match=words):
        rb.register(cloud, cloud, **settings)


def test_what_cannot_be_registered() -> None:
    flat, solid = np.ones((9, 2)), np.ones((9, 3))
    with pytest.raises(DataError, match="one is planar"):
        rb.register(flat, solid)
    with pytest.raises(DataError, match="no array of numbers"):
        rb.register("cloud.ply", flat)
    with pytest.raises(BackendError, match="3 points: expected at least 6"):
        rb.register(flat[:3], flat, "plicp")


# --- odometry


def test_odometry_is_the_run(corridor: rb.Dataset, tmp_path: Path) -> None:
    """The same bits in this process, in one of its own, and by the command line."""
    chosen = {"backend": "plicp", "selector": "rbtm", "selector__window": 6}
    odometry = rb.odometry(corridor, **chosen)
    run = rb.run(**chosen, **SMALL, out=tmp_path / "a")
    words = run.record["command"].split()[2:-1]
    assert call("run", *words, f"out={tmp_path / 'b'}", "pin=false")[0] == 0
    typed = json.loads((tmp_path / "b" / "run.json").read_text())
    ours = checksum(odometry.trajectory, 0)
    assert ours == run.record["trajectory_sha256"] == typed["trajectory_sha256"]
    steps = odometry.steps
    assert len(steps) == 20 and set(steps["reason"][1:]) == {"S > 0.7"}
    assert len(odometry.edges) == 19
    values = rb.evaluate(odometry, corridor)
    assert values["ape_rmse_m"] == run.metrics["ape_rmse_m"] > 0


@pytest.mark.parametrize("with_z", [False, True])
def test_a_live_stream_is_read_one_at_a_time(corridor: rb.Dataset, with_z: bool) -> None:
    drawn = []

    def live() -> Iterator[Any]:
        for scan in corridor:
            drawn.append(scan.index)
            yield scan.points if with_z else scan.points[:, :2]

    odometry = rb.odometry(live(), "plicp", "previous")
    assert drawn == [0]  # to see what kind of scans they are
    for number, step in enumerate(odometry):
        assert drawn == list(range(number + 1)) and step.record.scan == number
    listed = rb.odometry([scan.points for scan in corridor], "plicp", "previous")
    assert (listed.trajectory.T_world_scan == odometry.trajectory.T_world_scan).all()
    assert odometry.trajectory.stamps.tolist() == list(range(20))


def test_plug_ins_as_objects(corridor: rb.Dataset) -> None:
    class Second(rb.Selector):
        def order(self, scan: int, models: Any, scores: Any) -> list[tuple[int, str]]:
            return [(max(0, len(models) - 2), "second")]

    ours = rb.odometry(corridor, NoRegistration(), Second(capacity=4))
    assert (ours.steps["gap"][3:] == 2).all() and set(ours.steps["reason"][1:]) == {"second"}
    with pytest.raises(ConfigError, match="selector__window: expected of the object"):
        rb.odometry(corridor, "plicp", Second(capacity=4), selector__window=3)


def test_a_system_and_default_similarity(corridor: rb.Dataset) -> None:
    cloud = [scan.points[:, :2] for scan in corridor]
    assert rb.odometry(cloud[:8], "plicp").steps["score"].notna().any()  # of clouds without beams
    rng = np.random.default_rng(0)
    solid = [rng.uniform(-5, 5, (500, 3)) for _ in range(3)]
    assert len(rb.odometry(solid, "kiss_icp_system").trajectory) == 3


def test_streams_that_are_none(corridor: rb.Dataset) -> None:
    scans = [scan.points[:, :2] for scan in corridor]
    with pytest.raises(DataError, match="no scans"):
        rb.odometry([])
    with pytest.raises(DataError, match=r"scan 2 is not planar; the first one is"):
        _ = rb.odometry([*scans[:2], np.ones((9, 3))], "plicp").trajectory
    with pytest.raises(DataError, match="scan 0 comes after 0"):
        _ = rb.odometry([corridor[0], corridor[0]], "plicp").trajectory
    with pytest.raises(ConfigError, match="ground truth"):
        rb.odometry(scans, "plicp", "oracle")


# --- data, runs, numbers


def test_data_by_path(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number in range(3):
        np.save(tmp_path / f"{number}.npy", np.random.default_rng(number).uniform(-5, 5, (50, 3)))
    dataset = rb.open_dataset(tmp_path, dataset__max_scans=2)
    assert len(dataset) == 2 and not dataset.planar
    assert str(dataset.readings[0]) in capsys.readouterr().err
    with pytest.raises(DataError, match="no such file"):
        rb.open_dataset(tmp_path / "nothing")
    with pytest.raises(ConfigError, match="backend: no setting of open_dataset"):
        rb.open_dataset(tmp_path, backend="plicp")


def test_a_comparison_and_its_table(tmp_path: Path) -> None:
    lists = {"backend": ["none", "plicp"], "selector": ("previous", "rbtm"), "seed": range(2)}
    out = tmp_path / "grid"
    table = rb.compare(**lists, **SMALL, selector__window=6, jobs=1, controls="none", out=out)
    assert len(table) == 8 and set(table["status"]) == {"done"}
    assert table.attrs["out"] == str(out) and (out / "summary.csv").is_file()
    assert len(rb.load_runs(out, over_seeds=True)) == 4
    assert rb.load_runs([out, out / "none-rbtm-seed=0"]).shape == table.shape
    assert call("compare", "--resume", str(out))[0] == 0  # the command line takes it up
    with pytest.raises(ConfigError, match="already holds files"):
        rb.compare(**SMALL, out=out)
    with pytest.raises(ConfigError, match="jobs=0"):
        rb.compare(jobs=0)
    with pytest.raises(DataError, match="holds no run"):
        rb.load_runs(tmp_path / "grid" / "pairs")


def test_a_run_that_fails(tmp_path: Path) -> None:
    settings = {**SMALL, "selector": "previous", "time_limit": 1e-3}
    with pytest.raises(RunError, match="time limit"):
        rb.run(**settings, out=tmp_path / "a")
    assert rb.load_runs(tmp_path / "a")["reason"][0] == "time limit of 0.001 s"


def test_evaluate_takes_whatever_holds_poses(corridor: rb.Dataset, tmp_path: Path) -> None:
    truth = np.stack([scan.ground_truth for scan in corridor])
    stamps = np.array([scan.stamp for scan in corridor])
    moved = truth.copy()
    moved[5:, 0, 3] += 0.1
    exact, off = rb.Trajectory(stamps, truth), rb.Trajectory(stamps, moved)
    off.write_tum(tmp_path / "off.tum")
    expected = rb.evaluate(off, corridor)["ape_rmse_m"]
    assert expected == pytest.approx(0.1 * np.sqrt(15 / 20))
    for estimate, reference in ((moved, truth), (off, exact), (tmp_path / "off.tum", exact)):
        assert rb.evaluate(estimate, reference)["ape_rmse_m"] == pytest.approx(expected)
    fewer = rb.Trajectory(stamps[::2] + 0.001, truth[::2])
    assert rb.evaluate(off, fewer)["ape_max_m"] == pytest.approx(0.1)
    aligned = rb.evaluate(off, corridor, metrics__ape__align="none")["ape_rmse_m"]
    assert aligned == pytest.approx(expected)  # the first pose is the origin in both
    with pytest.raises(DataError, match="no two poses"):
        rb.evaluate(off, rb.Trajectory(stamps + 99, truth))
    with pytest.raises(DataError, match=r"expected poses \(N, 4, 4\)"):
        rb.evaluate(stamps, truth)
    with pytest.raises(DataError, match="poses"):
        rb.evaluate(moved[:5], truth)
