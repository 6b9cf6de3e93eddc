"""Each of KISS-ICP's formats on a small tree of its files: points, times and truth."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from cloud_helpers import write_cloud
from reader_mutants import cloud

from rbtm_bench.cli.commands import main
from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.datasets.kiss_formats import FORMATS
from rbtm_bench.datasets.kiss_loader import KissFormat
from rbtm_bench.datasets.recognise import recognise

START, COUNT = 1_600_000_000, 4
CONFIGS = Path(__file__).parents[2] / "configs" / "dataset"
STEP = 0.5
"""m along x from scan to scan."""


def scan(number: int) -> np.ndarray:
    return cloud() + 0.1 * number


def times(unit: int) -> list[int]:
    return [(START * 10 + i) * unit // 10 for i in range(COUNT)]


def records(path: Path, number: int, letters: str, wide: dict[str, str]) -> None:
    layout = np.dtype([(f"{i}", wide.get(c, c)) for i, c in enumerate(letters)])
    rows = np.zeros(len(scan(number)), layout)
    for i, column in enumerate(scan(number).T):
        rows[f"{i}"] = column
    rows.tofile(path)


def folder(*parts: str | Path) -> Path:
    place = Path(*parts)
    place.mkdir(parents=True, exist_ok=True)
    return place


def apollo(root: Path) -> Path:
    for i in range(COUNT):
        write_cloud(folder(root, "pcds") / f"{i + 1}.pcd", scan(i))
    rows = [f"{i + 1} {t / 10} {100 + STEP * i} 0 0 0 0 0 1" for i, t in enumerate(times(10))]
    (folder(root, "poses") / "gt_poses.txt").write_text("\n".join(rows) + "\n")
    return root


def boreas(root: Path) -> Path:
    rows = ["GPSTime,easting,northing,altitude,vx,vy,vz,roll,pitch,heading,wz,wy,wx"]
    for i, time in enumerate(times(10**6)):
        records(folder(root, "lidar") / f"{time}.bin", i, "ffffff", {"f": "<f4"})
        rows.append(f"{time},{100 + STEP * i},0,0,0,0,0,0,0,0,0,0,0")
    (folder(root, "applanix") / "lidar_poses.csv").write_text("\n".join(rows) + "\n")
    return root


def generic(root: Path) -> Path:
    for i in range(COUNT):
        write_cloud(root / f"{i + 8}.ply", scan(i))
    return root


def helipr(root: Path) -> Path:
    rows = []
    for i, time in enumerate(times(10**9)):
        place = folder(root, "LiDAR", "Ouster") / f"{time}.bin"
        records(place, i, "ffffIHHH", {"f": "<f4", "I": "<u4", "H": "<u2"})
        rows.append(f"{time} {STEP * i} 0 0 0 0 0 1")
    (folder(root, "LiDAR_GT") / "global_Ouster_gt.txt").write_text("\n".join(rows) + "\n")
    return root


def kitti_raw(root: Path) -> Path:
    drive = folder(root, "2011_09_30", "2011_09_30_drive_0016_sync")
    stamps = []
    for i in range(COUNT):
        place = folder(drive, "velodyne_points", "data") / f"{i:010d}.bin"
        np.column_stack([scan(i), np.ones(len(scan(i)))]).astype("<f4").tofile(place)
        east = float(np.rad2deg(STEP * i / 6378137))
        packet = [0.0, east, 0.0] + 27 * [0]
        text = " ".join(map(repr, packet))
        (folder(drive, "oxts", "data") / f"{i:010d}.txt").write_text(text + "\n")
        stamps.append(f"2020-09-13 12:26:40.{i}00000000")
    (drive / "velodyne_points" / "timestamps.txt").write_text("\n".join(stamps) + "\n")
    rigid = "R: 1 0 0 0 1 0 0 0 1\nT: 0 0 0\n"
    for name in ("calib_imu_to_velo.txt", "calib_velo_to_cam.txt"):
        (root / "2011_09_30" / name).write_text(rigid)
    lines = [
        f"P_rect_0{i}: 1 0 0 0 0 1 0 0 0 0 1 0\nR_rect_0{i}: 1 0 0 0 1 0 0 0 1" for i in range(4)
    ]
    (root / "2011_09_30" / "calib_cam_to_cam.txt").write_text("\n".join(lines) + "\n")
    return root


def mulran(root: Path) -> Path:
    rows = []
    for i, time in enumerate(times(10**9)):
        place = folder(root, "Ouster") / f"{time}.bin"
        np.column_stack([scan(i), np.ones(len(scan(i)))]).astype("<f4").tofile(place)
        rows.append(f"{time},1,0,0,{100 - STEP * i},0,1,0,0,0,0,1,0")
    (root / "global_pose.csv").write_text("\n".join(rows) + "\n")
    return root


def ncd(root: Path) -> Path:
    rows = ["#sec,nsec,x,y,z,qx,qy,qz,qw"]
    for i in range(COUNT):
        name = f"cloud_{START}_{i}00000000.pcd"
        write_cloud(folder(root, "raw_format", "ouster_scan") / name, scan(i))
        rows.append(f"{START},{i}00000000,{STEP * i},0,0,0,0,0,1")
    (folder(root, "ground_truth") / "registered_poses.csv").write_text("\n".join(rows) + "\n")
    return root


def nclt(root: Path) -> Path:
    around = times(10**6)
    rows = [f"{around[0] - 10**5},nan,nan,nan,0,0,0"]
    for i, time in enumerate(around):
        points = np.vstack([scan(i), [70.0, -80.0, 90.0]]) * [1, -1, -1]
        raw = np.column_stack([np.round((points + 100) / 0.005), np.zeros(len(points))])
        raw.astype("<u2").tofile(folder(root, "2012-01-08", "velodyne_sync") / f"{time}.bin")
        rows.append(f"{time},{STEP * i},0,0,0,0,0")
    rows.append(f"{around[-1] + 10**5},{STEP * COUNT},0,0,0,0,0")
    table = folder(root, "ground_truth") / "groundtruth_2012-01-08.csv"
    table.write_text("\n".join(rows) + "\n")
    return root / "2012-01-08"


def tum(root: Path) -> Path:
    import open3d as o3d

    depth, truth = [], []
    folder(root, "depth")
    empty = np.zeros((480, 640, 3), np.uint8)
    o3d.io.write_image(str(folder(root, "rgb") / "a.png"), o3d.geometry.Image(empty))
    for i in range(COUNT):
        image = np.full((480, 640), 2500 * (i + 1), np.uint16)  # 0.5 m
        o3d.io.write_image(str(root / "depth" / f"{i}.png"), o3d.geometry.Image(image))
        depth.append(f"{START}.{i} depth/{i}.png")
        if i != 1:  # scan 1 has no truth; the loader gives those behind it another's
            truth.append(f"{START}.{i} {STEP * i} 0 0 0 0 0 1")
    (root / "depth.txt").write_text("# depth maps\n" + "\n".join(depth) + "\n")
    (root / "groundtruth.txt").write_text("# truth\n" + "\n".join(truth) + "\n")
    return root


TREES: dict[str, tuple[Callable[[Path], Path], str | int | None]] = {
    "apollo": (apollo, None),
    "boreas": (boreas, None),
    "generic": (generic, None),
    "helipr": (helipr, "Ouster"),
    "kitti_raw": (kitti_raw, 4),
    "mulran": (mulran, None),
    "ncd": (ncd, None),
    "nclt": (nclt, None),
    "tum": (tum, None),
}


def made(name: str, root: Path, **settings: object) -> KissFormat:
    write, sequence = TREES[name]
    return KissFormat(str(write(root)), name, sequence, **settings)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", [name for name in TREES if name != "tum"])
def test_points_times_and_truth(name: str, tmp_path: Path) -> None:
    data = made(name, tmp_path)
    assert len(data) == COUNT
    for i, one in enumerate(data):
        expected = scan(i)
        if name == "nclt":
            expected = np.vstack([expected, [70.0, -80.0, 90.0]])
        off = {"kitti_raw": 0.1, "nclt": 0.004}.get(name, 1e-6)  # turned up; steps of 5 mm
        np.testing.assert_allclose(one.points, expected, atol=off)
        start = 0 if name == "generic" else START
        assert one.stamp == pytest.approx(start + 0.1 * i, abs=1e-4)
        if name == "generic":
            assert one.ground_truth is None
            continue
        assert one.ground_truth is not None
        moved = np.linalg.inv(data[0].ground_truth) @ one.ground_truth
        assert np.linalg.norm(moved[:3, 3]) == pytest.approx(STEP * i, abs=1e-3)
        np.testing.assert_allclose(moved[:3, :3], np.eye(3), atol=1e-3)
    assert len(data.fingerprint()) == 64 and data.readings and not data.suspicions


@pytest.mark.parametrize("name", [name for name in TREES if name != "generic"])
def test_its_folder_is_recognised(name: str, tmp_path: Path) -> None:
    path = TREES[name][0](tmp_path)
    found = recognise(str(path))
    assert (found.pop("dataset"), found.pop("dataset.path")) == (name, str(path))
    assert found == ({"dataset.sequence": "Ouster"} if name == "helipr" else {})
    (folder(tmp_path, "LiDAR", "Avia") / "0.bin").touch()
    if name == "helipr":
        with pytest.raises(DataError, match=r"sequences Avia, Ouster: dataset\.sequence="):
            recognise(str(path))


@pytest.mark.parametrize("name", ["boreas", "kitti_raw"])
def test_times_within_the_sweep(name: str, tmp_path: Path) -> None:
    data = made(name, tmp_path)
    sweep = float(np.median(np.diff(data.stamps)))
    kept = data[1]
    assert kept.times is not None and len(kept.times) == len(kept.points) and sweep > 0
    assert 0 <= kept.times.min() < kept.times.max() <= sweep
    again = made(name, tmp_path / "again", min_range=float(np.linalg.norm(kept.points[0])))[1]
    assert again.times is not None and len(again.times) == len(again.points) < len(kept.points)


def test_depth_images(tmp_path: Path) -> None:
    data = made("tum", tmp_path, tolerance_s=0.02)
    assert [one.ground_truth is not None for one in data] == [True, False, True, True]
    for i, one in enumerate(data):
        np.testing.assert_allclose(one.points[:, 2], 0.5 * (i + 1), atol=1e-6)
        assert one.stamp == pytest.approx(START + 0.1 * i)
        if one.ground_truth is not None:
            np.testing.assert_allclose(one.ground_truth[:3, 3], [STEP * i, 0, 0])


def test_truth_that_is_far_in_time_is_not_known(tmp_path: Path) -> None:
    write = mulran(tmp_path)
    table = write / "global_pose.csv"
    table.write_text("".join(f"{line}\n" for line in table.read_text().split()[:2]))
    data = KissFormat(str(write), "mulran", tolerance_s=0.05)
    assert [one.ground_truth is not None for one in data] == [True, True, False, False]
    assert "truth: 2 of 4 scans" in map(str, data.readings)


@pytest.mark.parametrize("name", TREES)
def test_what_is_missing_or_damaged_is_one_line(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made(name, folder(tmp_path, "good"))
    sequence = TREES[name][1]
    with pytest.raises((DataError, ConfigError)) as caught:
        KissFormat(str(tmp_path), name, sequence)  # type: ignore[arg-type]
    assert len(str(caught.value).splitlines()) == 1
    with pytest.raises(DataError, match="expected the folder"):
        KissFormat(str(tmp_path / "none"), name, sequence)  # type: ignore[arg-type]
    rng = np.random.default_rng(0)
    for file in [f for f in sorted((tmp_path / "good").rglob("*")) if f.is_file()]:
        content = file.read_bytes()
        for damaged in (content[: len(content) // 2 + 1], rng.bytes(len(content)), b""):
            file.write_bytes(damaged)
            try:
                place = tmp_path / "good" / ("2012-01-08" if name == "nclt" else "")
                for one in KissFormat(str(place), name, sequence):  # type: ignore[arg-type]
                    assert np.isfinite(one.points).all() and np.abs(one.points).max() < 2e4
            except (DataError, ConfigError) as error:
                assert len(str(error).splitlines()) == 1
        file.write_bytes(content)
    assert capsys.readouterr().out == ""


def test_sequences_as_they_are_typed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kitti_raw(folder(tmp_path, "raw"))
    helipr(folder(tmp_path, "lidar"))
    for name, where, sequence in (("kitti_raw", "raw", "04"), ("helipr", "lidar", "Ouster")):
        words = [f"dataset={name}", f"dataset.path={tmp_path / where}"]
        assert main(["data", *words, f"dataset.sequence={sequence}"]) == 0
        assert "scans         4, 3D" in capsys.readouterr().out
        assert main(["data", *words, "dataset.sequence=Other"]) == 2
        assert "dataset.sequence=Other: " in capsys.readouterr().err


def test_sequences_are_asked_for(tmp_path: Path) -> None:
    helipr(tmp_path)
    with pytest.raises(ConfigError, match=r"dataset\.sequence= says which sequence helipr reads"):
        KissFormat(str(tmp_path), "helipr")
    (tmp_path / "LiDAR" / "Ouster").rename(tmp_path / "LiDAR" / "Other")
    truth = tmp_path / "LiDAR_GT"
    (truth / "global_Ouster_gt.txt").rename(truth / "global_Other_gt.txt")
    with pytest.raises(DataError, match="Unsupported LiDAR Type"):
        KissFormat(str(tmp_path), "helipr", "Other")


@pytest.mark.parametrize("name", FORMATS)
def test_configs(name: str) -> None:
    import inspect

    section = yaml.safe_load((CONFIGS / f"{name}.yaml").read_text())["dataset"]
    assert section.pop("_target_") == "rbtm_bench.datasets.kiss_loader.KissFormat"
    parameters = inspect.signature(KissFormat).parameters
    assert list(section) == list(parameters) and section["loader"] == name
    assert section["path"] == "???"
    assert section["sequence"] == ("???" if FORMATS[name].sequence else None)
    for key in ("rate_hz", "stride", "max_scans", "min_range", "max_range"):
        assert section[key] == parameters[key].default
