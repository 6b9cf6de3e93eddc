"""All kinds of lines of CARMEN logs, and what PARAM lines say of the laser."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from carmen_writer import PLAIN_RANGES, Write, compose, drive, flaser, odom

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.datasets.carmen import Carmen
from rbtm_bench.datasets.planar import planar_poses

RANGES = [2.0 + 0.01 * i for i in range(91)]


def robotlaser(pose: Sequence[float], stamp: float, keyword: str = "ROBOTLASER1") -> str:
    """91 beams from -45 deg by 1, up to 30 m, with two remissions."""
    head = f"{keyword} 0 {-np.pi / 4!r} {np.pi / 2!r} {np.pi / 180!r} 30.0 0.01 0 {len(RANGES)}"
    poses = " ".join(repr(float(v)) for v in [*compose(pose, (0.2, 0, 0)), *pose])
    tail = f"{poses} 0 0 1 1 0" if keyword.startswith("ROBOT") else ""
    return f"{head} {' '.join(map(repr, RANGES))} 2 7.0 8.0 {tail} {stamp!r} host 0.5"


def room(heading: float, beams: int, first: float, spacing: float) -> list[float]:
    """Ranges from the middle of a room without symmetry."""
    angle = heading + np.deg2rad(first + spacing * np.arange(beams))
    return (4 + np.cos(angle) + 0.7 * np.sin(2 * angle) + 0.5 * np.cos(5 * angle)).tolist()


def turning(beams: int, first: float, spacing: float, count: int = 40) -> list[str]:
    turns = [[0.0, 0.0, 0.08 * i] for i in range(count)]
    return [
        line
        for i, pose in enumerate(turns)
        for line in (odom(pose, float(i)), flaser(pose, i, room(pose[2], beams, first, spacing)))
    ]


@pytest.mark.parametrize("keyword", ["ROBOTLASER1", "ROBOTLASER2"])
def test_robotlaser(write: Write, keyword: str) -> None:
    """The odometry is the laser's, 0.2 m ahead of the robot."""
    poses = drive(5)
    lines = [f(p, float(i)) for i, p in enumerate(poses) for f in (odom, robotlaser)]
    data = Carmen(write(*lines))
    assert np.rad2deg(data.angles[[0, -1]]) == pytest.approx([-45, 45])
    assert data.max_range == 30.0 and not data.corrected
    ahead = [compose(pose, (0.2, 0, 0)) for pose in poses]
    np.testing.assert_allclose(data.odometry, planar_poses(np.array(ahead)), atol=1e-12)
    np.testing.assert_array_equal(data[0].ranges, RANGES)


def test_rawlaser_takes_the_pose_from_the_odom_lines_by_time(write: Write) -> None:
    lines = ["PARAM robot_frontlaser_offset 0.3 host 0"]
    lines += [odom((float(i), 0, 0), float(i)) for i in range(4)]
    lines += [robotlaser((0, 0, 0), stamp, "RAWLASER1") for stamp in (0.5, 1.25)]
    data = Carmen(write(*lines))
    assert data.odometry is not None and not data.has_ground_truth
    assert data.odometry[:, 0, 3] == pytest.approx([0.8, 1.55])
    late = [robotlaser((0, 0, 0), 99.0, "RAWLASER1")]
    with pytest.raises(DataError, match=r"no RAWLASER1 line between .* \(0\.000 to 3\.000 s\)"):
        Carmen(write(*lines[:5], *late))
    assert not Carmen(write(*late)).has_odometry


def test_one_kind_of_lines_at_a_time(write: Write) -> None:
    front = [flaser((i, 0, 0), i) for i in range(3)]
    rear = [flaser((i, 0, np.pi), i).replace("FLASER", "RLASER") for i in range(2)]
    path = write(*front, *rear)
    assert len(Carmen(path)) == 3 and "3 FLASER lines" in Carmen(path).readings[0].taken
    assert len(Carmen(path, message="RLASER")) == 2
    assert len(Carmen(write(*rear, name="rear.log"))) == 2
    with pytest.raises(ConfigError, match="no RAWLASER1 line, there are FLASER, RLASER"):
        Carmen(path, message="RAWLASER1")


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda line: line.replace(" 91 ", " 90 ", 1), "ROBOTLASER1: expected|remissions"),
        (lambda line: line.replace(" 91 ", " -1 ", 1), "number of readings: expected a count"),
        (lambda line: line.replace(" 91 ", " 99999999999 ", 1), "number of readings"),
        (lambda line: " ".join(line.split()[:-4]), "ROBOTLASER1: expected"),
        (lambda line: line.replace(" 30.0 ", " far ", 1), "laser: expected a number, 'far'"),
        (lambda line: line.replace(" 30.0 ", " 31.0 ", 1), "laser: expected the settings of"),
    ],
)
def test_malformed_robotlaser(write: Write, change: Any, named: str) -> None:
    line = robotlaser((0, 0, 0), 1.0)
    with pytest.raises(DataError, match=f"line 2, .*({named})"):
        Carmen(write(line, change(line)))


def test_param_offset_moves_odometry_to_the_laser(write: Write) -> None:
    poses = drive(4)
    lines = [f(p, float(i)) for i, p in enumerate(poses) for f in (odom, flaser)]
    data = Carmen(write("PARAM robot_frontlaser_offset 0.25 host 0", *lines))
    ahead = [compose(pose, (0.25, 0, 0)) for pose in poses]
    np.testing.assert_allclose(data.odometry, planar_poses(np.array(ahead)), atol=1e-12)
    assert "moved to the laser" in next(r.taken for r in data.readings if r.what == "odometry")


@pytest.mark.parametrize("mirrored", [True, False])
def test_flipped_is_told_by_turns(write: Write, mirrored: bool) -> None:
    """CARMEN turns the readings of a laser upside down before it logs them, others do not."""
    lines = turning(181, *((90.0, -1.0) if mirrored else (-90.0, 1.0)))
    data = Carmen(write("PARAM laser_front_laser_flipped 1 host 0", *lines))
    assert np.rad2deg(data.angles[0]) == pytest.approx(90 if mirrored else -90)
    assert not data.suspicions
    silent = Carmen(write(*lines))
    assert any("fit angles [90,-1]" in text for text in silent.suspicions) == mirrored


def test_a_resolution_that_turns_belie_is_not_taken(write: Write) -> None:
    param = "PARAM laser_front_laser_resolution 0.5 host 0"
    data = Carmen(write(param, *turning(181, -90.0, 1.0)))
    assert np.rad2deg(data.angles[[0, -1]]) == pytest.approx([-90, 90])
    data = Carmen(write(param, *turning(181, -45.0, 0.5)))
    assert np.rad2deg(data.angles[[0, -1]]) == pytest.approx([-45, 45])
    still = write(param, *(flaser((0, 0, 0), i, [2.0] * 181) for i in range(3)))
    with pytest.raises(DataError, match=r"\[-45,0\.5\] .* or \[-90,1\] .* dataset\.angles="):
        Carmen(still)
    assert np.rad2deg(Carmen(still, angles=(-45, 0.5)).angles[-1]) == pytest.approx(45)


def test_unknown_counts_need_angles(write: Write) -> None:
    path = write(flaser((0, 0, 0), ranges=[1.0] * 100))
    with pytest.raises(DataError, match=r"angles of 100 readings are not known.*dataset\.angles="):
        Carmen(path)
    assert np.rad2deg(Carmen(path, angles=(-50.0, 1.0)).angles[-1]) == pytest.approx(49)


def test_centimetres(write: Write) -> None:
    ranges = [300.0 + i for i in range(170)] + [8183.0] * 10
    path = write(*(flaser((0, 0, 0), i, ranges) for i in range(3)))
    with pytest.raises(DataError, match=r"centimetres \(dataset\.scale=0\.01: 3\.\d+ m\)"):
        Carmen(path)
    data = Carmen(path, scale=0.01)
    assert data.max_range == pytest.approx(81.73) and np.nanmax(data.ranges) < 5


def test_absurd_readings_and_poses(write: Write) -> None:
    ranges = [*PLAIN_RANGES[:179], 1e30]
    data = Carmen(write(*(flaser((0, 0, 0), i, ranges) for i in range(3))))
    assert np.isnan(data.ranges[:, -1]).all() and data.dropped() == {"beyond 10 km": 3}
    with pytest.raises(DataError, match=r"pose: expected at most 1e\+07, '1e\+30' found"):
        Carmen(write(flaser((1e30, 0, 0))))


def test_odometry_or_truth_is_refused_where_it_is_unsure(write: Write) -> None:
    """Every second pose is off the ODOM lines' path."""
    poses = drive(20, (0.1, 0.0, 0.02))
    lines = []
    for i, pose in enumerate(poses):
        off = compose(pose, (0, 0.3, 0.2)) if i % 3 == 0 else compose(pose, (0.04, 0, 0.008))
        lines += [odom(pose, float(i)), flaser(off, float(i))]
    path = write(*lines)
    with pytest.raises(DataError, match=r"corrected=false: .*corrected=true: "):
        Carmen(path)
    assert not Carmen(path, corrected=False).has_ground_truth
    assert Carmen(path, corrected=True).has_ground_truth


def test_a_corrected_log_that_hardly_drifts(write: Write) -> None:
    """1 mm and 0.2 deg a step: all within a centimetre of the ODOM line before at first."""
    odometry, truth = drive(40, (0.05, 0, 0.02)), drive(40, (0.05, 0.001, 0.0235))
    lines = [f for o, t in zip(odometry, truth, strict=True) for f in (odom(o), flaser(t))]
    data = Carmen(write(*lines))
    assert data.corrected
    np.testing.assert_allclose(data.odometry, planar_poses(np.array(odometry)), atol=1e-12)


def test_marks_and_ends_of_other_systems(tmp_path: Any) -> None:
    text = "\ufeff" + "\r\n".join(flaser(pose, i) for i, pose in enumerate(drive(3))) + "\r\n"
    (tmp_path / "a.log").write_bytes(text.encode())
    assert len(Carmen(str(tmp_path / "a.log"))) == 3
