"""The simulated 3D drive, and the script that writes it."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.spatial import cKDTree

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.geometry import inverse, transform, translation_norm
from rbtm_bench.datasets.cloud_folder import CloudFolder
from rbtm_bench.datasets.simulated_hall import (
    FORMATS,
    drive,
    lidar_directions,
    simulate,
    write_hall,
)


def test_floor_under_the_sensor() -> None:
    """The lowest ring, 15 deg down from 1.2 m above the floor, meets it after 1.2 / sin(15 deg)."""
    (cloud,) = simulate(drive(1, 0.15), rings=16, noise=0.0, seed=0)
    assert len(cloud) == 16_000
    lowest = np.linalg.norm(cloud[:1000], axis=1)
    assert np.median(lowest) == pytest.approx(1.2 / np.sin(np.deg2rad(15)), abs=1e-4)
    np.testing.assert_allclose(cloud[:1000, 2].min(), -1.2, atol=1e-5)


@pytest.mark.parametrize("rings", [16, 32])
def test_the_lidar_has_its_rings(rings: int) -> None:
    directions = lidar_directions(rings)
    assert len(directions) == 16_000
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    assert len(np.unique(directions[:, 2].round(9))) == rings


def test_an_unknown_lidar() -> None:
    with pytest.raises(ConfigError, match="rings=64"):
        lidar_directions(64)


def test_steps_have_their_length() -> None:
    """On a circle of radius 5 m an arc of 0.15 m has a chord of 10 sin(0.015) m."""
    poses = drive(300, 0.15)
    steps = translation_norm(inverse(poses[:-1]) @ poses[1:])
    np.testing.assert_allclose(steps, 10 * np.sin(0.015), rtol=1e-9)


@pytest.mark.parametrize("suffix", FORMATS)
def test_what_is_written_fits_together(tmp_path: Path, suffix: str) -> None:
    """Clouds read back and moved by their poses lie on each other."""
    write_hall(tmp_path / "hall", scans=3, step=0.3, noise=0.0, suffix=suffix)
    folder = CloudFolder(str(tmp_path / "hall"), poses=str(tmp_path / "hall" / "poses.tum"))
    assert len(folder) == 3 and folder[2].stamp == pytest.approx(0.2)
    first, last = folder[0], folder[2]
    assert first.ground_truth is not None and last.ground_truth is not None
    fixed = transform(first.ground_truth, first.points)
    right = transform(last.ground_truth, last.points)
    wrong = transform(first.ground_truth, last.points)
    tree = cKDTree(fixed)
    assert np.median(tree.query(right)[0]) < 0.6 * np.median(tree.query(wrong)[0])


def test_a_folder_in_use_is_refused(tmp_path: Path) -> None:
    (tmp_path / "old.ply").touch()
    with pytest.raises(ConfigError, match="not empty"):
        write_hall(tmp_path, scans=1)
    with pytest.raises(ConfigError, match="found a file"):
        write_hall(tmp_path / "old.ply", scans=1)


@pytest.fixture(scope="module")
def script() -> ModuleType:
    path = Path(__file__).parents[2] / "scripts" / "simulate_clouds.py"
    spec = importlib.util.spec_from_file_location("simulate_clouds", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_script(tmp_path: Path, script: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "new" / "hall")
    assert script.main([out, "--scans", "2", "--format", "npy", "--rings", "32"]) == 0
    assert "2 clouds of 16000" in capsys.readouterr().out
    assert script.main([out, "--scans", "2"]) == 2
    assert capsys.readouterr().err == f"error: {out}: the folder is not empty\n"


def test_the_script_is_repeatable(tmp_path: Path, script: ModuleType) -> None:
    clouds = []
    for name, seed in (("a", "5"), ("b", "5"), ("c", "6")):
        script.main([str(tmp_path / name), "--scans", "1", "--format", "npy", "--seed", seed])
        clouds.append((tmp_path / name / "000000.npy").read_bytes())
    assert clouds[0] == clouds[1] != clouds[2]


@pytest.mark.parametrize(
    "arguments", [["--scans", "0"], ["--noise", "-1"], ["--seed", "-1"], ["--step", "x"]]
)
def test_the_script_refuses(tmp_path: Path, script: ModuleType, arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        script.main([str(tmp_path / "hall"), *arguments])
    assert stop.value.code == 2
    assert not (tmp_path / "hall").exists()
