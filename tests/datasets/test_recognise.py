"""A path is recognised, or it is said what it could be; the report of a data set is a screen."""

from __future__ import annotations

import gzip
import os
from pathlib import Path

import numpy as np
import pytest
from cloud_helpers import write_cloud
from reader_mutants import FORMATS, cloud, log

from rbtm_bench.cli.commands import main
from rbtm_bench.core.errors import DataError
from rbtm_bench.datasets.carmen import Carmen
from rbtm_bench.datasets.cloud_folder import CloudFolder
from rbtm_bench.datasets.recognise import recognise
from rbtm_bench.datasets.summary import WIDTH, report

SCREEN = 40


def test_a_log_with_its_relations(tmp_path: Path) -> None:
    path = tmp_path / "a.clf.gz"
    path.write_bytes(gzip.compress(log().encode()))
    assert recognise(str(path)) == {"dataset": "carmen", "dataset.path": str(path)}
    (tmp_path / "a.relations").write_text("0 1 0 0 0 0 0 0\n")
    for place in (path, tmp_path):
        found = recognise(str(place))
        assert found["dataset.relations"] == str(tmp_path / "a.relations")
    (tmp_path / "b.log").write_text(log())
    with pytest.raises(DataError, match=r"several logs or bags \(.*expected the path of one"):
        recognise(str(tmp_path))


def test_clouds_with_their_trajectory(tmp_path: Path) -> None:
    scans = tmp_path / "scans"
    scans.mkdir()
    write_cloud(scans / "0.pcd", cloud())
    (scans / "._0.pcd").write_bytes(b"\0")
    alone = {"dataset": "cloud_folder", "dataset.path": str(scans)}
    assert recognise(str(tmp_path)) == recognise(str(scans)) == alone
    (tmp_path / "trajectory.tum").write_text("0 0 0 0 0 0 0 1\n")
    for place in (tmp_path, scans):
        assert recognise(str(place))["dataset.poses"] == str(tmp_path / "trajectory.tum")
        assert recognise(str(place), ("dataset.poses",)) == alone
    (tmp_path / "other.tum").write_text("0 0 0 0 0 0 0 1\n")
    with pytest.raises(DataError, match=r"other\.tum, trajectory\.tum: dataset\.poses= says"):
        recognise(str(tmp_path))


def test_kitti_s_layout(tmp_path: Path) -> None:
    FORMATS["kitti times"].write(tmp_path)
    expected = {"dataset": "kitti", "dataset.path": str(tmp_path), "dataset.sequence": "0"}
    assert recognise(str(tmp_path)) == recognise(str(tmp_path / "sequences" / "00")) == expected
    (tmp_path / "sequences" / "01" / "velodyne").mkdir(parents=True)
    with pytest.raises(DataError, match=r"sequences 00, 01: dataset\.sequence= says which"):
        recognise(str(tmp_path))
    assert "dataset.sequence" not in recognise(str(tmp_path), ("dataset.sequence",))


def test_what_is_not_recognised(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("once upon a time\n")
    (tmp_path / "a.ply").write_text("ply\n")
    os.mkfifo(tmp_path / "pipe")
    for name, message in (
        ("a.txt", "not recognised: expected a CARMEN log"),
        ("a.ply", "a single cloud"),
        ("pipe", "a pipe or device"),
        ("nothing", "no such file or folder"),
    ):
        with pytest.raises(DataError, match=message):
            recognise(str(tmp_path / name))


def test_pipes_and_devices_are_refused_by_readers(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.clf")
    for path in (str(tmp_path / "a.clf"), "/dev/zero"):
        with pytest.raises(DataError, match="found a pipe or device"):
            Carmen(path)


def test_archives_that_unpack_to_too_much(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rbtm_bench.datasets.files.UNPACKED_ALWAYS", 1000)
    (tmp_path / "a.clf").write_bytes(gzip.compress(b"# nothing\n" * 100_000))
    with pytest.raises(DataError, match=r"a\.clf: unpacks to more than \d+ bytes"):
        Carmen(str(tmp_path / "a.clf"))


def test_every_number_of_the_report(tmp_path: Path) -> None:
    clouds = tmp_path / "clouds"
    clouds.mkdir()
    for i in range(4):
        points = cloud()
        points[0], points[1], points[2] = [np.nan] * 3, [0.0] * 3, [2e4, 0, 0]
        write_cloud(clouds / f"{i}.npy", points)
    stamps = [0.0, 0.2, 0.1, 9.0]
    text = "".join(f"{t} {i} 0 0 0 0 0 1\n" for i, t in enumerate(stamps))
    (tmp_path / "a.tum").write_text(text)
    data = CloudFolder(str(clouds), poses=str(tmp_path / "a.tum"))
    lines = report(data)
    assert len(lines) < SCREEN and max(map(len, lines)) <= WIDTH
    words = " ".join(" ".join(lines).split())
    for expected in (
        "scans 4, 3D",
        "9 s from 0.000000 s on, 10 Hz (median); 1 gaps of 5 steps or more, the longest 8.8 s",
        "points 297 to 297 a scan",
        "4 implausible (0.33%), 4 not finite (0.33%), 4 too near (0.33%) of 1200 points",
        "truth path 5 m over 4 of 4 scans",
        "time steps back 1 times from pose to pose",
    ):
        assert expected in words, expected


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.clf").write_text(log())
    assert main(["data", str(tmp_path / "a.clf")]) == 0
    out = capsys.readouterr().out
    assert "6, planar, 180 beams" in out and "copies of the ODOM lines" in out
    assert main(["data", "dataset=corridor", "dataset.scans=5"]) == 0
    assert capsys.readouterr().out.startswith("corridor: simulated\nscans         5, planar")
    for words, message in (
        ([], "expected a path, or dataset="),
        ([str(tmp_path / "none")], "no such file or folder"),
        ([str(tmp_path / "a.clf"), "--fast"], "--fast: no such option"),
        ([str(tmp_path / "a.clf"), "b"], "b: expected key=value"),
    ):
        assert main(["data", *words]) == 2
        assert message in capsys.readouterr().err


def test_real_data_are_recognised(data_dir: Path) -> None:
    expected = {"figure8": "cloud_folder", "kitti": "kitti", "freiburg/aces.clf.gz": "carmen"}
    for name, dataset in expected.items():
        assert recognise(str(data_dir / name))["dataset"] == dataset
    assert "dataset.relations" in recognise(str(data_dir / "freiburg" / "aces.clf.gz"))
