"""Bags of every kind: ranges, points, times, odometry and truth are those that were written."""

from __future__ import annotations

import bz2
import os
from pathlib import Path

import numpy as np
import pytest
from bag_writer import START, Entry, Messages, drive
from reader_mutants import cloud
from rosbags import rosbag1

from rbtm_bench.cli.commands import main
from rbtm_bench.core.errors import DataError
from rbtm_bench.datasets import bag_file
from rbtm_bench.datasets.bag import Bag
from rbtm_bench.datasets.recognise import recognise

KINDS = ("bag", "db3", "mcap")
RANGES = [np.nan, np.inf, 0.01, 1.5, 2.5, 29.0, 30.0, 35.0, 3.0, 0.0]


def lasers(make: Messages, count: int = 4) -> list[object]:
    return [make.laser(START + i * 10**8, np.array(RANGES) + i * 0.001) for i in range(count)]


def path_of(tmp_path: Path, kind: str) -> Path:
    return tmp_path / ("a.bag" if kind == "bag" else "a")


@pytest.mark.parametrize("kind", KINDS)
def test_a_laser(kind: str, tmp_path: Path) -> None:
    make = Messages(kind)
    path = make.write(path_of(tmp_path, kind), drive(make, lasers(make)))
    data = Bag(str(path))
    assert len(data) == 4 and data.planar and data.has_beams and data.has_odometry
    assert not data.has_ground_truth
    for i in (2, 0, 1, 3, 3):
        scan = data[i]
        expected = (np.array(RANGES) + i * 0.001).astype(np.float32).astype(float)
        expected[[0, 1, 2, 6, 7, 9]] = np.nan
        np.testing.assert_array_equal(scan.ranges, expected)
        np.testing.assert_allclose(scan.angles, -1.5 + 0.01 * np.arange(10), atol=1e-6)
        assert scan.stamp == pytest.approx(START / 1e9 + 0.1 * i, abs=1e-6)
        assert scan.odometry is not None and len(scan.points) == 4
        # half-way between two poses, the laser 0.2 m ahead, and everything in the plane
        np.testing.assert_allclose(scan.odometry[:3, 3], [0.1 * i + 0.2, 0, 0], atol=1e-6)
    assert data.dropped() == {"no return": 8, "not finite": 8, "too near": 8}
    assert recognise(str(path)) == {"dataset": "bag", "dataset.path": str(path)}
    if kind != "bag":
        folder = Bag(str(path.parent))
        np.testing.assert_array_equal(folder[1].ranges, data[1].ranges)
        assert recognise(str(path.parent))["dataset"] == "bag"


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("code", "pad", "rows", "tail"),
    [("<f4", 0, 1, 0), (">f4", 3, 1, 0), ("<f8", 4, 10, 5), (">f8", 1, 3, 2)],
)
def test_a_cloud(kind: str, code: str, pad: int, rows: int, tail: int, tmp_path: Path) -> None:
    make = Messages(kind)
    points = cloud()
    points[0] = np.nan
    scans = [
        make.cloud(START + i * 10**8, points + 0.01 * i, code, pad, rows, tail) for i in range(3)
    ]
    path = make.write(path_of(tmp_path, kind), drive(make, scans))
    data = Bag(str(path))
    assert not data.planar and not data.has_beams and len(data) == 3
    for i, scan in enumerate(data):
        expected = (points[1:] + 0.01 * i).astype(code).astype(float)
        np.testing.assert_array_equal(scan.points, expected)
        assert scan.odometry is not None and scan.ranges is None
        np.testing.assert_allclose(scan.odometry[:3, 3], [0.1 * i + 0.2, 0, 0.5], atol=1e-6)
    assert data.dropped() == {"not finite": 3}
    assert recognise(str(path))["dataset"] == "bag_clouds"


def test_sizes_of_clouds_are_claims(tmp_path: Path) -> None:
    make = Messages("bag")
    scans = [make.cloud(START + i * 10**8, cloud()) for i in range(4)]
    scans[1].width = 2**31
    scans[2].fields[2].offset = 2**31
    scans[3].fields[0].name = "r"
    data = Bag(str(make.write(tmp_path / "a.bag", drive(make, scans))))
    for scan, words in ((1, "2147483648 points"), (2, "field z at"), (3, "expected the fields")):
        with pytest.raises(DataError, match=rf"a\.bag, /scan {scan}: .*{words}"):
            data[scan]


def test_tf_and_topics_that_are_the_truth(tmp_path: Path) -> None:
    make = Messages("mcap")
    entries: list[Entry] = []
    turn = (0, 0, np.sin(0.25), np.cos(0.25))
    for topic, time, message in drive(make, lasers(make)):
        if topic == "/odom":
            stamp = message.header.stamp
            x = message.pose.pose.position.x
            when = stamp.sec * 10**9 + stamp.nanosec
            entries.append(("/tf", time, make.tf(when, "odom", "base", (x, 1, 0), turn)))
            entries.append(("/ground_truth/odom", time, make.odometry(when, (x, 2, 0))))
        else:
            entries.append((topic, time, message))
    data = Bag(str(make.write(tmp_path / "a", entries)))
    scan = data[1]
    assert scan.odometry is not None and scan.ground_truth is not None
    expected = [0.1 + 0.2 * np.cos(0.5), 1 + 0.2 * np.sin(0.5), 0]
    np.testing.assert_allclose(scan.odometry[:3, 3], expected, atol=1e-6)
    np.testing.assert_allclose(scan.ground_truth[:3, 3], [0.3, 2, 0], atol=1e-6)
    path = str(next((tmp_path / "a").glob("*.mcap")))
    named = Bag(path, odometry_topic="ground_truth/odom", truth_topic="/tf", truth_frame="odom")
    np.testing.assert_array_equal(named[1].odometry, scan.ground_truth)
    np.testing.assert_array_equal(named[1].ground_truth, scan.odometry)
    nothing = Bag(path, odometry_topic=None, truth_topic=None)
    assert not nothing.has_odometry and not nothing.has_ground_truth
    with pytest.raises(DataError, match=r"no chain of tf from map to laser"):
        Bag(path, truth_topic="/tf")
    assert len({Bag(path).fingerprint(), named.fingerprint(), nothing.fingerprint()}) == 3


def test_a_laser_upside_down(tmp_path: Path) -> None:
    make = Messages("bag")
    entries = drive(make, lasers(make))
    entries[0] = ("/tf_static", START, make.tf(START, "base", "laser", (0.2, 0, 0), (1, 0, 0, 0)))
    data = Bag(str(make.write(tmp_path / "a.bag", entries)))
    scan = data[0]
    assert scan.odometry is not None and scan.angles is not None
    np.testing.assert_allclose(scan.odometry, [[1, 0, 0, 0.2], *np.eye(4)[1:]], atol=1e-6)
    np.testing.assert_allclose(scan.angles, 1.5 - 0.01 * np.arange(10), atol=1e-6)
    assert any("upside down" in text for text in data.suspicions)


def test_several_topics_are_listed(tmp_path: Path) -> None:
    make = Messages("bag")
    entries = drive(make, lasers(make))
    more = [("/rear", time, one) for topic, time, one in entries if topic == "/scan"]
    more += [("/wheel", time, one) for topic, time, one in entries if topic == "/odom"]
    path = str(make.write(tmp_path / "a.bag", entries + more))
    with pytest.raises(DataError, match=r"/rear \(sensor_msgs/LaserScan, 4\), /scan .*topic= says"):
        Bag(path)
    with pytest.raises(DataError, match=r"/odom .*, /wheel .*dataset\.odometry_topic= says which"):
        Bag(path, topic="scan")
    assert len(Bag(path, topic="scan", odometry_topic="/wheel")) == 4
    with pytest.raises(DataError, match=r"no topic /front for dataset\.topic="):
        Bag(path, topic="/front")


def test_scans_without_odometry_and_times(tmp_path: Path) -> None:
    make = Messages("bag")
    all_of_it = drive(make, lasers(make))
    entries = [e for e in all_of_it if e[1] > START or e[0] == "/scan"]
    data = Bag(str(make.write(tmp_path / "a.bag", entries)))
    assert len(data) == 3 and data[0].stamp == pytest.approx(START / 1e9 + 0.1)
    assert any("1 scans without odometry" in text for text in data.suspicions)
    assert any("no transform from base to laser" in text for text in data.suspicions)
    few = [e for e in all_of_it if e[1] > START + 2 * 10**8 or e[0] == "/scan"]
    few_path = str(make.write(tmp_path / "few.bag", few))
    with pytest.raises(DataError, match=r"3 of 4 scans have no odometry.*tolerance_s="):
        Bag(few_path)
    assert len(Bag(few_path, odometry_topic=None)) == 4
    silent = [make.laser(0, RANGES) for _ in range(3)]
    alone = [("/scan", START + i * 10**8, one) for i, one in enumerate(silent)]
    data = Bag(str(make.write(tmp_path / "b.bag", alone)))
    assert [round(s.stamp - START / 1e9, 3) for s in data] == [0, 0.1, 0.2]
    late = drive(make, [make.laser(START + 10**12, RANGES)])
    with pytest.raises(
        DataError, match=r"no pose of /odom within 0\.25 s of a scan: poses are from"
    ):
        Bag(str(make.write(tmp_path / "c.bag", late)))


def test_damaged_bags_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    make = Messages("bag")
    path = make.write(tmp_path / "a.bag", drive(make, lasers(make)))
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    assert main(["data", str(path)]) == 2
    error = capsys.readouterr().err
    assert "a.bag: a damaged bag" in error and len(error.splitlines()) == 1
    (tmp_path / "b.bag").write_bytes(b"no bag")
    with pytest.raises(DataError, match=r"b\.bag: no bag"):
        Bag(str(tmp_path / "b.bag"))
    os.mkfifo(tmp_path / "c.bag")
    with pytest.raises(DataError, match="a pipe or device"):
        Bag(str(tmp_path / "c.bag"))
    (tmp_path / "d.dat").write_bytes(content)
    with pytest.raises(DataError, match=r"d\.dat: a bag whose name must end in \.bag"):
        Bag(str(tmp_path / "d.dat"))
    for how in rosbag1.Writer.CompressionFormat:
        packed = make.write(
            tmp_path / f"{how.name}.bag", drive(make, lasers(make)), compression=how
        )
        assert len(Bag(str(packed))[3].points) == 4
    monkeypatch.setattr(bag_file, "UNPACKED_ALWAYS", 100)
    with pytest.raises(DataError, match="a chunk is cut short, or unpacks to more than"):
        bag_file._unpacked("a.bag", bz2.BZ2Decompressor, bz2.compress(bytes(10**6)))


def test_settings_are_told(tmp_path: Path) -> None:
    make = Messages("bag")
    path = str(make.write(tmp_path / "a.bag", drive(make, lasers(make))))
    data = Bag(path, angles=(-45.0, 0.5), max_range=20.0, min_range=2.0, stride=2, max_scans=1)
    scan = data[0]
    assert len(data) == 1 and scan.ranges is not None and scan.angles is not None
    assert np.isfinite(scan.ranges).nonzero()[0].tolist() == [4, 8]
    np.testing.assert_allclose(scan.angles, np.deg2rad(-45 + 0.5 * np.arange(10)))
    wide = [make.laser(START, np.full(180, 2.0), -np.pi / 2, np.pi / 179)]
    data = Bag(str(make.write(tmp_path / "b.bag", [("/scan", START, wide[0])])))
    assert any("dataset.angles=[-90,1]" in text for text in data.suspicions)


# --- the real bags --------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["aces", "mit-csail"])
def test_real_bags_hold_the_scans_of_the_log(name: str, data_dir: Path) -> None:
    from rbtm_bench.datasets.carmen import Carmen

    data = Bag(str(data_dir / "bags" / f"{name}.bag"))
    log = Carmen(str(data_dir / "freiburg" / f"{name}.clf.gz"))
    assert len(data) == len(log) and log.odometry is not None and data.odometry is not None
    np.testing.assert_allclose(data.odometry, log.odometry, atol=1e-9)
    for i in range(0, len(log), 1 if name == "mit-csail" else 50):
        np.testing.assert_allclose(data[i].ranges, log.beams(i), atol=2e-6)
    if name == "mit-csail":
        np.testing.assert_allclose(data[0].angles, log.angles, atol=1e-7)
    else:
        assert any("dataset.angles=[-90,1]" in text for text in data.suspicions)
