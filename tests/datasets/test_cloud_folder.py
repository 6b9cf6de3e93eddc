"""Folders of clouds: every format reads the same, and every damage is reported."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cloud_helpers import write_cloud

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.geometry import is_rigid
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.cloud_files import SUFFIXES, read_points
from rbtm_bench.datasets.cloud_folder import CloudFolder
from rbtm_bench.datasets.cloud_times import natural_key

POINTS = np.random.default_rng(0).uniform(-5, 5, (100, 3)).astype(np.float32).astype(float)

TUM = "0.0 1 2 3 0 0 0 1\n0.5 1 2 3 0 0 0.70710678 0.70710678\n"
KITTI = "1 0 0 1 0 1 0 2 0 0 1 3\n0 -1 0 1 1 0 0 2 0 0 1 3\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two good clouds, scan1.npy and scan2.npy."""
    place = tmp_path / "clouds"
    place.mkdir()
    for number in (1, 2):
        write_cloud(place / f"scan{number}.npy", POINTS + number)
    return place


def write_ascii(path: Path, points: Array) -> None:
    rows = "\n".join(f"7 {x!r} {y!r} {z!r}" for x, y, z in points.tolist())
    if path.suffix == ".ply":
        names = "".join(f"property float {name}\n" for name in ("intensity", "x", "y", "z"))
        header = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n{names}end_header\n"
    else:
        header = (
            "# .PCD v0.7\nVERSION 0.7\nFIELDS intensity x y z\nSIZE 4 4 4 4\nTYPE F F F F\n"
            f"COUNT 1 1 1 1\nWIDTH {len(points)}\nHEIGHT 1\nPOINTS {len(points)}\nDATA ascii\n"
        )
    path.write_text(header + rows + "\n")


def write_compressed(path: Path, points: Array) -> None:
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    o3d.io.write_point_cloud(path, cloud, compressed=True)


# --- what is read ---------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [s for s in SUFFIXES if s not in (".las", ".laz")])
def test_every_format_reads_the_same(tmp_path: Path, suffix: str) -> None:
    write_cloud(tmp_path / f"a{suffix}", POINTS)
    scan = CloudFolder(str(tmp_path))[0]
    assert scan.points.dtype == np.float64 and not scan.planar and scan.ranges is None
    digits = 1e-10 if suffix == ".xyz" else 0.0  # Open3D writes ten of them
    np.testing.assert_allclose(scan.points, POINTS, rtol=0, atol=digits)


@pytest.mark.parametrize("name", ["a.ply", "a.pcd"])
def test_ascii(tmp_path: Path, name: str) -> None:
    write_ascii(tmp_path / name, POINTS)
    np.testing.assert_array_equal(read_points(tmp_path / name), POINTS)


def test_compressed_pcd(tmp_path: Path) -> None:
    write_compressed(tmp_path / "a.pcd", POINTS)
    np.testing.assert_array_equal(read_points(tmp_path / "a.pcd"), POINTS)


def test_npy_may_be_wider_and_of_integers(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.arange(1, 11).reshape(2, 5))
    np.testing.assert_array_equal(read_points(tmp_path / "a.npy"), [[1, 2, 3], [6, 7, 8]])


def test_natural_order(tmp_path: Path) -> None:
    for number in (1, 2, 10):
        write_cloud(tmp_path / f"scan{number}.npy", POINTS + number)
    (tmp_path / "notes.txt").write_text("not a cloud")
    (tmp_path / "folder.ply").mkdir()
    names = [file.name for file in CloudFolder(str(tmp_path)).files]
    assert names == ["scan1.npy", "scan2.npy", "scan10.npy"]
    mixed = ["b", "a10", "10", "a", "2", "a2b1", "a02"]
    assert sorted(mixed, key=natural_key) == ["2", "10", "a", "a02", "a2b1", "a10", "b"]


def test_pattern_and_max_scans(folder: Path) -> None:
    write_cloud(folder / "other.ply", POINTS)
    with pytest.raises(DataError, match=r"\.npy and \.ply files: dataset\.pattern='\*\.npy'"):
        CloudFolder(str(folder))
    assert len(CloudFolder(str(folder), pattern="scan*")) == 2
    assert len(CloudFolder(str(folder), pattern="scan*", max_scans=1)) == 1
    with pytest.raises(DataError, match=r"no \.ply, .* file matches pattern '\*\.xyz'"):
        CloudFolder(str(folder), pattern="*.xyz")
    with pytest.raises(ConfigError, match="pattern="):
        CloudFolder(str(folder), pattern="/absolute/*")


def test_points_without_meaning_are_dropped(tmp_path: Path) -> None:
    bad = [[np.nan, 0, 0], [np.inf, 1, 1], [0, 0, 0]]
    np.save(tmp_path / "a.npy", np.array([*bad, [1, 0, 0], [0, 2, 0], [0, 0, 3]]))
    np.testing.assert_array_equal(
        CloudFolder(str(tmp_path))[0].points, [[1, 0, 0], [0, 2, 0], [0, 0, 3]]
    )
    limited = CloudFolder(str(tmp_path), min_range=1.0, max_range=3.0)
    np.testing.assert_array_equal(limited[0].points, [[0, 2, 0]])


def test_stamps(folder: Path, tmp_path: Path) -> None:
    assert [scan.stamp for scan in CloudFolder(str(folder), rate_hz=4.0)] == [0.0, 0.25]
    (tmp_path / "poses").write_text(TUM)
    with_poses = CloudFolder(str(folder), poses=str(tmp_path / "poses"))
    assert [scan.stamp for scan in with_poses] == [0.0, 0.5]


@pytest.mark.parametrize("text", [TUM, KITTI, "# a comment\n\n" + TUM, KITTI.replace(" ", "   ")])
def test_poses(folder: Path, tmp_path: Path, text: str) -> None:
    """The second pose is a quarter turn to the left at (1, 2, 3)."""
    (tmp_path / "poses").write_text(text)
    clouds = CloudFolder(str(folder), poses=str(tmp_path / "poses"))
    assert clouds.has_ground_truth and not clouds.has_odometry
    pose = clouds[1].ground_truth
    assert pose is not None and is_rigid(pose, 1e-12)
    expected = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    np.testing.assert_allclose(pose, expected, atol=1e-7)


def test_a_kitti_rotation_with_few_digits_becomes_exact(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "poses").write_text(
        "1 0 0 0 0 1 0 0 0 0 1 0\n0.866 -0.5 0 0 0.5 0.866 0 0 0 0 1 0\n"
    )
    pose = CloudFolder(str(folder), poses=str(tmp_path / "poses"))[1].ground_truth
    assert pose is not None and is_rigid(pose, 1e-12)


# --- damage ---------------------------------------------------------------------------------


def cut(data: bytes) -> bytes:
    return data[: len(data) * 2 // 3]


BINARY = [".ply", ".pcd", ".bin", ".npy"]


@pytest.mark.parametrize("suffix", BINARY)
@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda data: b"", "file is empty"),
        (lambda data: b"hello world", "."),
        (lambda data: data[:20], "."),
        (lambda data: bytes(range(256)) * 8 + b"x", "."),
        (lambda data: data[: len(data) * 2 // 3 - 1], "."),
        (lambda data: data[:-1], "."),
    ],
)
@pytest.mark.filterwarnings("error")
def test_damaged_files(
    tmp_path: Path, suffix: str, damage: Callable[[bytes], bytes], message: str
) -> None:
    path = tmp_path / f"a{suffix}"
    write_cloud(path, POINTS)
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(DataError, match=message) as caught:
        CloudFolder(str(tmp_path))[0]
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["a.ply", "a.pcd"])
@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda text: text[: len(text) // 2], "."),
        (lambda text: text[: text.index("7 ")], "truncated, 100 points announced"),
        (lambda text: text.rsplit("\n", 3)[0], "100 points announced, 98 readable"),
        (lambda text: text.replace("\n7 -", "\n7 oops-", 2), "in the points, .*oops"),
        (lambda text: text.replace("\n7 ", "\n7 8 ", 2), "point 0: 4 numbers expected, 5 found"),
        (
            lambda text: text.replace("vertex 100", "vertex x").replace("POINTS 100", "POINTS x"),
            "a count, 'x' found",
        ),
        (lambda text: text.replace(" ascii", " magic"), "encoding 'magic'"),
        (
            lambda text: text.replace("float y\n", "float q\n").replace(" x y z\n", " x q z\n"),
            "must give",
        ),
    ],
)
@pytest.mark.filterwarnings("error")
def test_damaged_ascii(
    tmp_path: Path, name: str, damage: Callable[[str], str], message: str
) -> None:
    path = tmp_path / name
    write_ascii(path, POINTS)
    path.write_text(damage(path.read_text()))
    with pytest.raises(DataError, match=message):
        CloudFolder(str(tmp_path))[0]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("element vertex", "element face 3\nelement vertex", "100 points announced, 97 readable"),
        ("float x", "complex x", "a type of PLY, 'complex' found"),
        ("property float x", "property list uchar int i\nproperty float x", "a count, '-*[0-9]"),
        ("ply\n", "plyx\n", "line 1, header: expected ply"),
    ],
)
def test_ply_headers(tmp_path: Path, old: str, new: str, message: str) -> None:
    write_ascii(tmp_path / "a.ply", POINTS)
    text = (tmp_path / "a.ply").read_text()
    (tmp_path / "a.ply").write_text(text.replace(old, new, 1))
    with pytest.raises(DataError, match=message):
        read_points(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((5, 2)), r"expected an array \(N, 3\) or wider, found \(5, 2\)"),
        (np.zeros(5), "expected an array"),
        (np.zeros((5, 3), dtype=complex), "expected real numbers"),
        (np.array([["a", "b", "c"]]), "expected real numbers"),
        (np.array([[None, 1, 2]], dtype=object), "not a readable .npy"),
    ],
)
def test_npy_of_another_kind(tmp_path: Path, array: Any, message: str) -> None:
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(DataError, match=message):
        CloudFolder(str(tmp_path))


def test_what_is_seen_at_opening(folder: Path) -> None:
    for file in folder.iterdir():
        file.unlink()
    (folder / "scan3.bin").write_bytes(b"x" * 50)
    with pytest.raises(DataError, match=r"scan3\.bin: 50 bytes are no whole number of records"):
        CloudFolder(str(folder), layout="kitti")
    with pytest.raises(DataError, match=r"scan3\.bin: its 50 bytes are plausible points in none"):
        CloudFolder(str(folder))
    (folder / "scan3.bin").write_bytes(b"")
    with pytest.raises(DataError, match=r"scan3\.bin: the file is empty"):
        CloudFolder(str(folder))


def test_a_cloud_without_points(folder: Path) -> None:
    np.save(folder / "scan3.npy", np.full((4, 3), np.nan))
    with pytest.raises(DataError, match=r"scan3\.npy: no point within range \(4 points"):
        CloudFolder(str(folder))[2]
    np.save(folder / "scan3.npy", np.empty((0, 3)))
    with pytest.raises(DataError, match="no point within range"):
        CloudFolder(str(folder))[2]


def test_skip(folder: Path, tmp_path: Path) -> None:
    """Scans and poses stay together when a cloud between them is left out."""
    write_cloud(folder / "scan3.npy", POINTS + 3)
    (folder / "scan2.npy").write_bytes(b"junk")
    (tmp_path / "poses").write_text("".join(f"{i} {i} 0 0 0 0 0 1\n" for i in (1, 2, 3)))
    clouds = CloudFolder(str(folder), poses=str(tmp_path / "poses"), on_error="skip")
    assert (len(clouds), clouds.skipped) == (2, 1)
    last = clouds[1]
    assert last.ground_truth is not None and last.ground_truth[0, 3] == 3.0
    assert last.stamp == 3.0 and last.index == 1
    np.testing.assert_array_equal(last.points, POINTS + 3)
    (folder / "scan1.npy").write_bytes(b"junk")
    (folder / "scan3.npy").write_bytes(b"junk")
    with pytest.raises(DataError, match="no usable cloud, 3 malformed"):
        CloudFolder(str(folder), on_error="skip")


def test_no_folder(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "empty").mkdir()
    for name, message in (
        ("file", "found a file"),
        ("none", "no such folder"),
        ("empty", "no .ply"),
    ):
        with pytest.raises(DataError, match=message):
            CloudFolder(str(tmp_path / name))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (TUM + TUM, "4 poses for 2 clouds"),
        ("", "file is empty"),
        ("# only a comment\n", "no pose in the file"),
        ("1 2 3\n", "line 1, pose: expected 8 columns .* 3 found"),
        (TUM[:-10], "line 2, pose: "),
        (KITTI + "1 2 3\n", "line 3, pose: expected 12 columns, 3 found"),
        (TUM.replace("1 2 3", "1 x 3"), "line 1, pose: expected a number, 'x' found"),
        (KITTI.replace("2", "nan"), "line 1, pose: expected a finite number"),
        ("0 0 0 0 0 0 0 0\n", "line 1, pose: expected a rotation"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0\n", "line 1, pose: expected a rotation"),
        ("2 0 0 0 0 1 0 0 0 0 1 0\n", "line 1, pose: expected a rotation"),
    ],
)
def test_bad_poses(folder: Path, tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "poses").write_text(text)
    with pytest.raises(DataError, match=message) as caught:
        CloudFolder(str(folder), poses=str(tmp_path / "poses"))
    assert str(tmp_path / "poses") in str(caught.value)


@pytest.mark.parametrize("index", [-1, 2])
def test_there_is_no_scan_before_the_first_or_after_the_last(folder: Path, index: int) -> None:
    with pytest.raises(IndexError):
        CloudFolder(str(folder))[index]


def test_fingerprint(folder: Path, tmp_path: Path) -> None:
    base = CloudFolder(str(folder)).fingerprint()
    assert base == CloudFolder(str(folder)).fingerprint()
    (tmp_path / "poses").write_text(KITTI)
    others = [
        CloudFolder(str(folder), poses=str(tmp_path / "poses")),
        CloudFolder(str(folder), rate_hz=5.0),
        CloudFolder(str(folder), min_range=1.0),
        CloudFolder(str(folder), max_range=9.0),
        CloudFolder(str(folder), max_scans=1),
    ]
    prints = {base, *(clouds.fingerprint() for clouds in others)}
    write_cloud(folder / "scan2.npy", POINTS)
    prints.add(CloudFolder(str(folder)).fingerprint())
    assert len(prints) == len(others) + 2
    # The same clouds elsewhere are the same data.
    write_cloud(folder / "scan2.npy", POINTS + 2)
    assert CloudFolder(str(folder.rename(tmp_path / "moved"))).fingerprint() == base


def test_real_velodyne(data_dir: Path) -> None:
    folder = data_dir / "kitti" / "sequences" / "00" / "velodyne"
    clouds = CloudFolder(str(folder), max_range=80.0)
    assert len(clouds) == 20
    assert len(CloudFolder(str(folder))[0].points) == 1994688 // 16
    assert clouds[19].points.shape[0] > 100_000
    assert np.linalg.norm(clouds[0].points, axis=1).max() < 80.0
