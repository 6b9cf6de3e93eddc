"""Trajectory files: columns by their names, times in any unit, and poses that belong to clouds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rbtm_bench.core.errors import DataError
from rbtm_bench.datasets.cloud_folder import CloudFolder
from rbtm_bench.datasets.cloud_times import decimal, list_files
from rbtm_bench.datasets.poses_file import read_poses_file

S = float(np.sqrt(0.5))
PLAIN = f"0 1 2 3 0 0 0 1\n1 1 2 4 0 0 {S!r} {S!r}\n"
"""The second pose is a quarter turn to the left."""
FIRST = f"0 1 2 3 1 0 0 0\n1 1 2 4 {S!r} 0 0 {S!r}\n"
"""The same, with the scalar first."""
TURN = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
EUROC = (
    "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
    ",v_RS_R_x [m s^-1]\n"
    f"1403636580838555648,1,2,3,1,0,0,0,9\n1403636581838555648,1,2,4,{S!r},0,0,{S!r},9\n"
)


@pytest.mark.parametrize(
    "text",
    [
        PLAIN,
        PLAIN.replace(" ", ","),
        PLAIN.replace(" ", ", "),
        PLAIN.replace(" ", "\t").replace("\n", "\r\n"),
        "\ufeff" + PLAIN,
        "\ufeff# a comment\n" + PLAIN,
        "timestamp x y z qx qy qz qw\n" + PLAIN,
        "# timestamp tx ty tz qw qx qy qz\n" + FIRST,
        "time,x,y,z,q_w,q_x,q_y,q_z\n" + FIRST.replace(" ", ","),
        EUROC,
        FIRST,
    ],
)
def test_one_trajectory_in_many_spellings(tmp_path: Path, text: str) -> None:
    (tmp_path / "poses").write_bytes(text.encode())
    file = read_poses_file(tmp_path / "poses")
    assert file.stamps is not None and np.ptp(file.stamps) == pytest.approx(1.0)
    np.testing.assert_allclose(file.poses[:, :3, 3], [[1, 2, 3], [1, 2, 4]])
    np.testing.assert_allclose(file.poses[1, :3, :3], TURN, atol=1e-9)
    assert bool(file.note) == (text == FIRST or ("w" in text and "qz qw" not in text))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# t x y z\n1 2 3 4\n", "expected 8 columns"),
        ("0 1e8 0 0 0 0 0 1\n", r"pose: expected a position within 1e\+07 m"),
        ("123456789012 0 0 0 0 0 0 1\n", "times of 12 digits: expected s, ms, us or ns"),
        ("0 1_0 0 0 0 0 0 1\n", "expected a number, '1_0' found"),
    ],
)
def test_what_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "poses").write_text(text)
    with pytest.raises(DataError, match=message):
        read_poses_file(tmp_path / "poses")


def clouds(folder: Path, *names: str) -> Path:
    folder.mkdir()
    for number, name in enumerate(names):
        np.save(folder / f"{name}.npy", np.random.default_rng(number).uniform(1, 5, (20, 3)))
    return folder


def tum(path: Path, *stamps: float) -> str:
    """Poses at these times, 1 m a second along x."""
    path.write_text("".join(f"{t!r} {t % 100!r} 0 0 0 0 0 1\n" for t in stamps))
    return str(path)


def test_names_are_times(tmp_path: Path) -> None:
    names = ("1700000010.4", "1700000010.35", "1700000010.5", "1700000010.45")
    folder = clouds(tmp_path / "c", *names)
    poses = tum(tmp_path / "t", *(1.7e9 + 10 + 0.05 * i for i in range(6, 10)), 1.7e9 + 20)
    data = CloudFolder(str(folder), poses=poses)
    assert [file.stem[-3:].strip(".") for file in data.files] == [
        ".35"[1:],
        "0.4",
        ".45"[1:],
        "0.5",
    ]
    assert data.stamps - 1.7e9 == pytest.approx([10.35, 10.4, 10.45, 10.5])
    known = [scan.ground_truth is not None for scan in data]
    assert known == [True, True, True, False] and data.has_ground_truth
    assert any("3 of 4 clouds by time" in reading.taken for reading in data.readings)
    with pytest.raises(DataError, match=r"5 poses for 4 clouds: the clouds are from .*poses from"):
        CloudFolder(str(folder), poses=tum(tmp_path / "u", 1, 2, 3, 4, 5))
    with pytest.raises(DataError, match=r"odometry for 3 of 4 clouds only"):
        CloudFolder(str(folder), odometry=poses)


@pytest.mark.parametrize(
    ("name", "stamp"), [("1700000000123", 1.7e9 + 0.123), ("lidar_1700000000500000", 1.7e9 + 0.5)]
)
def test_units_of_times_in_names(tmp_path: Path, name: str, stamp: float) -> None:
    assert CloudFolder(str(clouds(tmp_path / "c", name))).stamps == pytest.approx([stamp])


def test_versions_are_no_decimal_numbers(tmp_path: Path) -> None:
    folder = clouds(tmp_path / "c", "scan1.1", "scan1.10", "scan1.2")
    names = [file.stem for file in list_files(str(folder), "*", (".npy",))]
    assert names == ["scan1.1", "scan1.2", "scan1.10"]
    assert decimal("a1.10.npy") == decimal("a1.1.npy") and decimal("a1b2.npy") is None


def test_odometry_of_clouds(tmp_path: Path) -> None:
    folder = clouds(tmp_path / "c", "0", "1", "2")
    data = CloudFolder(str(folder), odometry=tum(tmp_path / "o", 5, 6, 7))
    assert data.has_odometry and not data.has_ground_truth
    assert [scan.odometry[0, 3] for scan in data] == [5, 6, 7]  # type: ignore[index]
    assert data.stamps.tolist() == [5, 6, 7]
    plain = CloudFolder(str(folder))
    assert data.fingerprint() != plain.fingerprint()


def test_columns_and_arrays_on_their_side(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-5, 5, (50, 3))
    folder = tmp_path / "c"
    folder.mkdir()
    np.save(folder / "0.npy", points.T)
    np.testing.assert_array_equal(CloudFolder(str(folder))[0].points, points)
    np.save(folder / "0.npy", np.column_stack([np.arange(50), points]))
    with pytest.raises(DataError, match=r"column 0 only grows.*dataset\.columns=\[0,1,2\]"):
        CloudFolder(str(folder))[0]
    data = CloudFolder(str(folder), columns=(1, 2, 3))
    np.testing.assert_array_equal(data[0].points, points)


def test_the_world_s_frame_by_the_poses(tmp_path: Path) -> None:
    folder = tmp_path / "c"
    folder.mkdir()
    points = np.random.default_rng(0).uniform(-5, 5, (50, 3))
    for i in range(3):
        np.save(folder / f"{i}.npy", points + np.array([5e5 + i, 5e6, 300]))
    (tmp_path / "t").write_text("".join(f"{i} {5e5 + i} 5e6 300 0 0 0 1\n" for i in range(3)))
    data = CloudFolder(str(folder), poses=str(tmp_path / "t"))
    for scan in data:
        np.testing.assert_allclose(scan.points, points, atol=1e-8)
    assert any("brought to the sensor" in r.taken for r in data.readings) and not data.suspicions
