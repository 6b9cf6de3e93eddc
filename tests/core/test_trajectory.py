"""Trajectories as TUM files."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.geometry import is_rigid, se2
from rbtm_bench.core.trajectory import Trajectory, orthonormalised
from rbtm_bench.core.types import Array


def random_poses(n: int, seed: int, reach: float = 1e3) -> Array:
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, :3] = Rotation.random(n, rng=rng).as_matrix() if n else np.eye(3)
    T[:, :3, 3] = rng.uniform(-reach, reach, size=(n, 3))
    return T


def test_orthonormalised_squares_the_error():
    T = random_poses(20, 0)
    rough = T.copy()
    rough[:, :3, :3] += np.random.default_rng(1).normal(scale=1e-6, size=(20, 3, 3))
    better = orthonormalised(rough)
    assert all(is_rigid(pose, tolerance=1e-10) for pose in better)
    assert np.abs(better - T).max() < 1e-5
    assert np.array_equal(orthonormalised(rough[3]), better[3])


# --- Trajectory


def test_shapes_are_checked():
    assert len(Trajectory(np.zeros(0), np.zeros((0, 4, 4)))) == 0
    for stamps, poses in [
        (np.zeros(2), np.zeros((3, 4, 4))),
        (np.zeros((2, 1)), np.zeros((2, 4, 4))),
        (np.zeros(2), np.zeros((2, 3, 4))),
    ]:
        with pytest.raises(ValueError, match="expected"):
            Trajectory(stamps, poses)


def test_known_poses():
    T = random_poses(3, 0)
    T[1] = np.nan
    assert Trajectory(np.arange(3.0), T).known.tolist() == [True, False, True]


@settings(deadline=None, max_examples=30)
@given(
    stamps=st.lists(st.floats(0, 2e9), min_size=1, max_size=20),
    seed=st.integers(0, 10_000),
    reach=st.sampled_from([1e-6, 1.0, 1e6]),
)
def test_round_trip(tmp_path_factory, stamps, seed, reach):
    path = tmp_path_factory.getbasetemp() / "round.tum"
    written = Trajectory(np.array(stamps), random_poses(len(stamps), seed, reach))
    written.write_tum(path)
    read = Trajectory.read_tum(path)
    assert np.array_equal(read.stamps, written.stamps)
    assert np.array_equal(read.T_world_scan[:, :, 3], written.T_world_scan[:, :, 3])
    assert np.abs(read.T_world_scan[:, :3, :3] - written.T_world_scan[:, :3, :3]).max() < 1e-14


def test_the_file_is_tum(tmp_path):
    path = tmp_path / "one.tum"
    Trajectory(np.array([1134864645.90321]), se2(1, -2, np.pi / 2)[None]).write_tum(path)
    fields = [float(field) for field in path.read_text().split()]
    half = np.sqrt(0.5)
    assert fields == pytest.approx([1134864645.90321, 1, -2, 0, 0, 0, half, half], abs=1e-9)
    assert fields[0] == 1134864645.90321
    mask = os.umask(0)
    os.umask(mask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~mask


def test_writing_replaces_the_old_file_and_leaves_nothing_beside_it(tmp_path):
    path = tmp_path / "a.tum"
    path.write_text("old")
    Trajectory(np.arange(2.0), random_poses(2, 0)).write_tum(path)
    assert len(Trajectory.read_tum(path)) == 2
    assert [p.name for p in tmp_path.iterdir()] == ["a.tum"]


def test_a_write_that_fails_keeps_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.tum"
    path.write_text("old")

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("evo.tools.file_interface.np.savetxt", full)
    with pytest.raises(DataError, match="cannot be written: No space left on device"):
        Trajectory(np.arange(2.0), random_poses(2, 0)).write_tum(path)
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.tum"]


def test_what_cannot_be_written_is_refused(tmp_path):
    path = tmp_path / "a.tum"
    T = random_poses(2, 0)
    T[1] = np.nan
    for stamps, poses in [
        (np.zeros(0), np.zeros((0, 4, 4))),
        (np.zeros(2), T),
        (np.array([0, np.inf]), random_poses(2, 0)),
    ]:
        with pytest.raises(DataError, match="needs at least one pose"):
            Trajectory(stamps, poses).write_tum(path)
    with pytest.raises(DataError, match="cannot be written: No such file"):
        Trajectory(np.zeros(1), random_poses(1, 0)).write_tum(tmp_path / "no" / "a.tum")
    assert list(tmp_path.iterdir()) == []


GOOD = "1 2 3 4 0 0 0 1\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1, poses: expected at least one line stamp tx"),
        ("# stamp tx ty tz qx qy qz qw\n", "line 1, poses: expected at least one line"),
        ("# c\n" + GOOD + "1 2 3 4 0 0 0\n", "line 3, 7 fields: expected 8: stamp tx ty tz"),
        (GOOD + "1 2 3 4 0 0 0 1 9\n" + GOOD, "line 2, 9 fields: expected 8"),
        ("1 2 3 4 0 0 0 1 \n", "line 1, 9 fields: expected 8.*single spaces"),
        (GOOD + "\n" + GOOD, "line 2, 1 fields: expected 8"),
        (GOOD + "1 2 three 4 0 0 0 1\n", "line 2, pose: expected 8 numbers"),
        ("1,2,3,4,0,0,0,1\n", "line 1, 1 fields: expected 8"),
        (GOOD + "1 2 nan 4 0 0 0 1\n", "line 2, pose: expected finite numbers"),
        (GOOD + GOOD + "1 2 3 4 0 0 0 0\n", "line 3, quaternion: expected norm 1"),
        ("1 2 3 4 0 0 0 1.01\n", "line 1, quaternion: expected norm 1"),
        (b"\x1f\x8b\x08\xff\xfe\n", "line 1, 1 fields: expected 8"),
        ('"1 2 3 4 0 0 0 1\n', "line 1, pose: expected 8 numbers"),
    ],
)
def test_malformed_files_name_file_and_line(tmp_path, text, message):
    path = tmp_path / "bad.tum"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(DataError, match=f"bad.tum, {message}") as error:
        Trajectory.read_tum(path)
    assert "\n" not in str(error.value)


def test_missing_files(tmp_path):
    with pytest.raises(DataError, match=r"none.tum: cannot be read: No such file"):
        Trajectory.read_tum(tmp_path / "none.tum")
    with pytest.raises(DataError, match="not a regular file"):
        Trajectory.read_tum(tmp_path)


def test_comments_windows_line_ends_and_byte_order_marks_are_read(tmp_path: Path):
    path = tmp_path / "windows.tum"
    path.write_bytes(b"\xef\xbb\xbf# comment\r\n5 1 2 3 0 0 0 1\r\n4 1 2 3 0 0 0 0.9999\r\n")
    read = Trajectory.read_tum(path)
    assert read.stamps.tolist() == [5.0, 4.0]
    assert all(is_rigid(T) for T in read.T_world_scan)
