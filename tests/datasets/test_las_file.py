"""LAS and LAZ files as laspy writes them, and what is refused."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from reader_mutants import cloud, write_las

from rbtm_bench.cli.commands import main
from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.datasets.cloud_files import read_points
from rbtm_bench.datasets.cloud_folder import CloudFolder


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_points_are_read_by_scale_and_offset(
    tmp_path: Path, suffix: str, capsys: pytest.CaptureFixture[str]
) -> None:
    import laspy

    for number in range(3):
        write_las(tmp_path / f"{number}{suffix}", cloud() + 0.1 * number)
    np.testing.assert_allclose(read_points(tmp_path / f"1{suffix}"), cloud() + 0.1, atol=1e-4)
    assert main(["data", str(tmp_path)]) == 0
    assert "300 to 300 a scan" in capsys.readouterr().out
    newer = laspy.create(point_format=6, file_version="1.4")
    newer.header.scales, newer.header.offsets = np.full(3, 1e-3), np.array([500000.0, 5400000.0, 0])
    newer.x, newer.y, newer.z = (cloud() + newer.header.offsets).T
    newer.write(tmp_path / f"1{suffix}")
    read = read_points(tmp_path / f"1{suffix}")
    np.testing.assert_allclose(read - newer.header.offsets, cloud(), atol=1e-3)


def test_a_folder_in_coordinates_of_the_world(tmp_path: Path) -> None:
    import laspy

    for number in range(2):
        las = laspy.create(point_format=0, file_version="1.2")
        las.header.scales, las.header.offsets = np.full(3, 1e-3), np.array([512345.0, 5403205.0, 9])
        las.x, las.y, las.z = (cloud() + las.header.offsets).T
        las.write(tmp_path / f"{number}.las")
    data = CloudFolder(str(tmp_path))
    assert any("coordinates of the world" in word for word in data.suspicions)
    assert np.abs(data[0].points).max() < 30


def test_counts_are_held_against_the_file(tmp_path: Path) -> None:
    write_las(tmp_path / "a.las", cloud())
    content = bytearray((tmp_path / "a.las").read_bytes())
    content[107:111] = np.uint32(4_000_000_000).tobytes()  # legacy number of points
    (tmp_path / "a.las").write_bytes(content)
    with pytest.raises(DataError, match=r"a\.las: truncated, 4000000000 points announced"):
        read_points(tmp_path / "a.las")
    (tmp_path / "b.laz").write_bytes(b"LASF" + bytes(40))
    with pytest.raises(DataError, match=r"b\.laz: cannot be read"):
        read_points(tmp_path / "b.laz")


def test_without_laspy_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_las(tmp_path / "a.las", cloud())
    monkeypatch.setitem(sys.modules, "laspy", None)
    with pytest.raises(ConfigError, match=r"a\.las: needs laspy: pip install rbtm-bench\[las\]"):
        CloudFolder(str(tmp_path))
