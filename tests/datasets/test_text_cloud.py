"""Clouds in text: names, columns, counts, and what is wrong by file and line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from reader_mutants import cloud

from rbtm_bench.core.errors import DataError
from rbtm_bench.datasets.cloud_files import read_points
from rbtm_bench.datasets.cloud_folder import CloudFolder


def rows(order: str = "{0!r} {1!r} {2!r}") -> str:
    return "".join(order.format(*point) + "\n" for point in cloud().tolist())


@pytest.mark.parametrize(
    ("name", "text", "columns"),
    [
        ("a.xyz", rows(), None),
        ("a.xyz", f"300\n{rows()}", None),
        ("a.csv", "\ufeffx,y,z\r\n" + rows("{0!r},{1!r},{2!r}").replace("\n", "\r\n"), None),
        ("a.csv", '"t";"z";"Y";"x"\n' + rows("7;{2!r};{1!r};{0!r}"), None),
        ("a.txt", "# by hand\n" + rows("7 {2!r} {1!r} {0!r}"), (3, 2, 1)),
        ("a.csv", "a,b,c,d\n" + rows("{2!r},1,{0!r},{1!r}"), (2, 3, 0)),
    ],
)
def test_text(name: str, text: str, columns: tuple[int, int, int] | None, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8", newline="")
    np.testing.assert_array_equal(read_points(tmp_path / name, columns=columns), cloud())
    data = CloudFolder(str(tmp_path), pattern=f"*{Path(name).suffix}", columns=columns)
    np.testing.assert_array_equal(data[0].points, cloud())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3\n1 2\n", r"a\.xyz, line 2, point: expected 3 numbers, 2 found"),
        ("1 2 3\n1 two 3\n", r"a\.xyz, line 2, point: expected a number, 'two' found"),
        ("1 2 3\n1 2_0 3\n", r"line 2, point: expected a number, '2_0' found"),
        ("1 2\n", r"line 1, point: expected x y z, '1 2' found"),
        ("x y z\n", "no point in the file"),
        ("".join(f"{i} 1 2 3\n" for i in range(9)), "column 0 only grows"),
    ],
)
def test_what_is_wrong(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text(text)
    with pytest.raises(DataError, match=message):
        read_points(tmp_path / "a.xyz")


def test_text_beside_clouds_is_no_cloud(tmp_path: Path) -> None:
    (tmp_path / "0.xyz").write_text(rows())
    (tmp_path / "poses.txt").write_text("0 0 0 0 0 0 0 1\n")
    assert len(CloudFolder(str(tmp_path))) == 1
    with pytest.raises(DataError, match=r"3 columns, but columns=\[0, 1, 9\]"):
        CloudFolder(str(tmp_path), columns=(0, 1, 9))[0]
