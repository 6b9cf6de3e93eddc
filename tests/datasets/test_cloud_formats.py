"""PCD and PLY files as others write them: the same points, whatever stands around them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rbtm_bench.core.errors import DataError
from rbtm_bench.datasets import lzf
from rbtm_bench.datasets.binary_layouts import LAYOUTS, find_layout
from rbtm_bench.datasets.cloud_files import read_points
from rbtm_bench.datasets.cloud_folder import CloudFolder

POINTS = np.random.default_rng(0).uniform(-5, 5, (40, 3)).astype(np.float32).astype(float)
DOUBLE, FLOAT = ("8", "F", "<f8"), ("4", "F", "<f4")


def pcd(path: Path, fields: list[tuple[str, str, str, str, int]], head: str, data: str) -> None:
    """Fields (name, size, type, numpy type, count) of which x, y, z hold the points."""
    dtype = np.dtype([(f"{i}", f[3], (f[4],)) for i, f in enumerate(fields)])
    rows = np.zeros(len(POINTS), dtype)
    for i, (name, *_) in enumerate(fields):
        rows[f"{i}"] = POINTS[:, "xyz".index(name), None] if name in "xyz" else 7
    columns = list(zip(*fields, strict=True))
    header = "# .PCD v0.7\nVERSION 0.7\n" + "".join(
        f"{key} {' '.join(map(str, columns[i]))}\n"
        for key, i in (("FIELDS", 0), ("SIZE", 1), ("TYPE", 2), ("COUNT", 4))
    )
    body = rows.tobytes()
    if data == "binary_compressed":
        body = b"".join(rows[f"{i}"].tobytes() for i in range(len(fields)))
        body = b"".join(bytes([len(c) - 1]) + c for c in _pieces(body))
        body = np.array([len(body), len(rows) * dtype.itemsize], "<u4").tobytes() + body
    path.write_bytes(f"{header}{head}DATA {data}\n".encode() + body)


def _pieces(body: bytes) -> list[bytes]:
    return [body[i : i + 32] for i in range(0, len(body), 32)]


COUNTS = "WIDTH 40\nHEIGHT 1\nPOINTS 40\n"


@pytest.mark.parametrize("data", ["binary", "binary_compressed"])
@pytest.mark.parametrize(
    "fields",
    [
        [(n, *DOUBLE, 1) for n in "xyz"],
        [("t", "8", "U", "<u8", 1), *((n, *FLOAT, 1) for n in "xyz"), ("ring", "2", "U", "<u2", 1)],
        [("x", *FLOAT, 1), ("_", "1", "U", "u1", 4), ("y", *DOUBLE, 1), ("z", *FLOAT, 1)],
        [*((n, *FLOAT, 1) for n in "xyz"), ("_", "1", "U", "u1", 4), ("_", "1", "U", "u1", 12)],
        [("normal", *FLOAT, 33), *((n, *FLOAT, 1) for n in "zyx")],
    ],
)
@pytest.mark.parametrize("head", [COUNTS, "WIDTH 8\nHEIGHT 5\n", "POINTS 40\n"])
def test_pcd_fields(
    tmp_path: Path, fields: list[tuple[str, str, str, str, int]], head: str, data: str
) -> None:
    pcd(tmp_path / "a.pcd", fields, head, data)
    np.testing.assert_array_equal(read_points(tmp_path / "a.pcd"), POINTS)


@pytest.mark.parametrize(
    ("head", "message"),
    [
        ("WIDTH 40\nHEIGHT 1\nPOINTS 39\n", "39 POINTS announced, but WIDTH x HEIGHT is 40"),
        ("WIDTH 39\nHEIGHT 1\nPOINTS 39\n", "12 bytes more than 39 points announced"),
        ("POINTS 41\n", "truncated, 41 points announced take 492 bytes, 480 are left"),
        ("POINTS ²\n", "header: expected a count"),
        ("", "the header must give a number of points"),
    ],
)
def test_pcd_counts_are_claims(tmp_path: Path, head: str, message: str) -> None:
    pcd(tmp_path / "a.pcd", [(n, *FLOAT, 1) for n in "xyz"], head, "binary")
    with pytest.raises(DataError, match=message):
        read_points(tmp_path / "a.pcd")


def test_lzf() -> None:
    """Literals, then seven bytes from six back, twice over, then a long run of one byte."""
    packed = bytes([5]) + b"abcdef" + bytes([5 << 5, 5, 7 << 5, 100, 0])
    assert lzf.unpack(packed, 6 + 7 + 109) is not None
    unpacked = lzf.unpack(packed, 122)
    assert unpacked is not None and unpacked.tobytes() == b"abcdefabcdefa" + 109 * b"a"
    for wrong in (packed[:-1], packed[:4], bytes([5 << 5, 5]), packed + b"\xff"):
        assert lzf.unpack(wrong, 122) is None
    assert lzf.unpack(packed, 10**12) is None


@pytest.mark.parametrize(("word", "order"), [("little", "<"), ("big", ">")])
def test_ply_with_everything_around_the_vertices(tmp_path: Path, word: str, order: str) -> None:
    header = (
        f"ply\nformat binary_{word}_endian 1.0\ncomment by hand\n"
        "element camera 1\nproperty list uchar float view\nproperty double t\n"
        "element vertex 40\nproperty uchar red\nproperty double z\nproperty list uint8 int32 ids\n"
        "property float x\nproperty float y\n"
        "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    )
    body = b"\x02" + np.array([1, 2], order + "f4").tobytes() + np.array(9, order + "f8").tobytes()
    for i, (x, y, z) in enumerate(POINTS):
        ids = np.arange(i % 3, dtype=order + "i4")
        body += b"\xff" + np.array(z, order + "f8").tobytes()
        body += bytes([len(ids)]) + ids.tobytes() + np.array([x, y], order + "f4").tobytes()
    faces = 2 * (b"\x03" + np.arange(3, dtype=order + "i4").tobytes())
    path = tmp_path / "a.ply"
    path.write_bytes(header.encode() + body + faces)
    np.testing.assert_array_equal(read_points(path), POINTS)
    for damaged in (body[:-7] + faces, body + faces[:-1], body + faces + faces):
        path.write_bytes(header.encode() + damaged)
        with pytest.raises(DataError):
            read_points(path)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_is_told(tmp_path: Path, layout: str) -> None:
    """A ring of walls in the order of a scan."""
    one = LAYOUTS[layout]
    turn = np.linspace(0, 12 * np.pi, 600)
    radius = 8 + 2 * np.sin(3 * turn)
    z = np.repeat([-1.0, 0.2, 1.4], 200)
    points = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), z])
    raw = np.zeros((600, one.fields), one.dtype)
    raw[:, :3] = np.round((points - one.shift) / one.scale) if one.scale != 1 else points
    raw[:, 3:] = np.arange(one.fields - 3)
    (tmp_path / "0.bin").write_bytes(raw.tobytes())
    assert find_layout([tmp_path / "0.bin"])[0] == layout
    np.testing.assert_allclose(CloudFolder(str(tmp_path))[0].points, points, atol=3e-3)


def test_swapped_bytes_are_said(tmp_path: Path) -> None:
    rows = np.column_stack([POINTS, np.ones(40)]).astype(">f4")
    (tmp_path / "0.bin").write_bytes(rows.tobytes())
    with pytest.raises(DataError, match="kitti, bytes swapped: such files are not read"):
        CloudFolder(str(tmp_path))
