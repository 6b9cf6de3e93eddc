"""g2o files: written and read again, a sample by hand, and files that are spoiled."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.geometry import se2, se3
from rbtm_bench.graph.g2o import read_g2o, write_g2o
from rbtm_bench.graph.motions import small
from rbtm_bench.graph.optimise import optimise
from rbtm_bench.graph.pose_graph import PoseGraph

PLANE = """VERTEX_SE2 3 0 0 0
VERTEX_SE2 5 1 2 1.5707963267948966
FIX 3
EDGE_SE2 3 5 1 2 1.5 100 1 2 200 3 400
# may be wrong
EDGE_SE2 5 3 -2 1 -1.5 1 0 0 1 0 1
"""
UNIT = " ".join("1" if i in (0, 6, 11, 15, 18, 20) else "0" for i in range(21))
SPACE = f"""VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 1 1 2 3 0 0 1 0
EDGE_SE3:QUAT 0 1 1 2 3 0 0 1 0 {UNIT}
"""


def random_graph(planar: bool) -> PoseGraph:
    rng = np.random.default_rng(4)

    def pose():
        if planar:
            return se2(*rng.normal(0, 2, 3))
        return se3(rng.normal(0, 2, 3), Rotation.from_rotvec(rng.normal(0, 1, 3)).as_matrix())

    axes = [0, 1, 5] if planar else list(range(6))
    information = np.zeros((6, 6, 6))
    for k in range(6):
        A = rng.normal(0, 1, (len(axes), len(axes)))
        information[k][np.ix_(axes, axes)] = A @ A.T
    return PoseGraph(
        np.array([2, 3, 7, 11, 12]),
        np.stack([pose() for _ in range(5)]),
        np.array([(0, 1), (1, 2), (2, 3), (3, 4), (0, 4), (1, 3)]),
        np.stack([pose() for _ in range(6)]),
        information,
        np.array([False] * 4 + [True] * 2),
        planar,
    )


@pytest.mark.parametrize("planar", [True, False])
def test_round_trip(tmp_path: Path, planar) -> None:
    graph = random_graph(planar)
    write_g2o(tmp_path / "graph.g2o", graph)
    again = read_g2o(tmp_path / "graph.g2o")
    for name in ("scans", "ends", "may_be_wrong"):
        np.testing.assert_array_equal(getattr(again, name), getattr(graph, name))
    for name in ("T_world_scan", "T_model_scan", "information"):
        np.testing.assert_allclose(getattr(again, name), getattr(graph, name), atol=1e-14)
    assert again.planar == planar
    first = optimise(graph, None, iterations=5).cost
    assert optimise(again, None, iterations=5).cost == pytest.approx(first)


def test_a_file_in_the_plane_by_hand(tmp_path: Path) -> None:
    (tmp_path / "a.g2o").write_text(PLANE)
    graph = read_g2o(tmp_path / "a.g2o")
    assert graph.planar and graph.scans.tolist() == [3, 5]
    np.testing.assert_allclose(graph.T_world_scan[1], se2(1, 2, np.pi / 2))
    assert graph.may_be_wrong.tolist() == [False, True]
    assert graph.weights()[0].tolist() == [[100, 1, 2], [1, 200, 3], [2, 3, 400]]
    np.testing.assert_allclose(graph.residuals()[0], [0, 0, np.pi / 2 - 1.5], atol=1e-15)


def test_a_file_in_space_by_hand(tmp_path: Path) -> None:
    """A small turn r weighs as g2o's own error, the quaternion's vector part r / 2, does."""
    (tmp_path / "a.g2o").write_text(SPACE)
    graph = read_g2o(tmp_path / "a.g2o")
    np.testing.assert_allclose(graph.residuals()[0], np.zeros(6), atol=1e-12)
    np.testing.assert_allclose(np.diag(graph.information[0]), [1, 1, 1, 0.25, 0.25, 0.25])
    off = se3([0, 0, 0], Rotation.from_rotvec([0.02, 0, 0]).as_matrix())
    e = small(off[None])[0]
    vector_part = Rotation.from_matrix(off[:3, :3]).as_quat()[:3]
    assert e @ graph.information[0] @ e == pytest.approx(float(vector_part @ vector_part), rel=1e-4)


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("VERTEX_SE2 5", "VERTEX_SE2 3", 2, "each vertex once"),
        ("VERTEX_SE2 5", "VERTEX_XY 5", 2, "VERTEX_XY: expected one of VERTEX_SE2"),
        ("VERTEX_SE2 5 1 2", "VERTEX_SE2 5 1", 2, "with 4 words: expected 5"),
        ("VERTEX_SE2 5", "VERTEX_SE2 -5", 2, "a whole number"),
        ("VERTEX_SE2 5", "VERTEX_SE2 9999999999999999999999", 2, "a whole number"),
        ("1 2 1.57", "1 nan 1.57", 2, "finite"),
        ("1 2 1.57", "1 x 1.57", 2, "finite"),
        ("FIX 3", "FIX 4", 3, "vertices above"),
        ("FIX 3", "FIX", 3, "vertices above"),
        ("EDGE_SE2 3 5", "EDGE_SE2 3 6", 4, "two vertices of the file"),
        ("EDGE_SE2 3 5", "EDGE_SE2 3 3", 4, "two vertices of the file"),
        ("EDGE_SE2 3 5", "EDGE_SE3:QUAT 3 5", 4, "of one kind"),
        ("100 1 2 200 3 400", "100 1 2 200 3", 4, "with 11 words: expected 12"),
        ("100 1 2 200 3 400", "100 1 2 -200 3 400", 4, "positive semidefinite"),
        ("100 1 2 200 3 400", "inf 1 2 200 3 400", 4, "finite"),
    ],
)
def test_spoiled_files(tmp_path: Path, old, new, line, message) -> None:
    assert old in PLANE
    path = tmp_path / "spoiled.g2o"
    path.write_text(PLANE.replace(old, new, 1))
    with pytest.raises(DataError, match=message) as caught:
        read_g2o(path)
    text = str(caught.value)
    assert f"spoiled.g2o:{line}" in text or f"line {line}" in text
    assert "\n" not in text


def test_files_that_are_none(tmp_path: Path) -> None:
    path = tmp_path / "none.g2o"
    for content in (
        b"",
        b"# nothing\n",
        b"\xff\xfe\x00",
        SPACE.replace("0 0 1 0", "0 0 9 0").encode(),
    ):
        path.write_bytes(content)
        with pytest.raises(DataError, match=r"none\.g2o"):
            read_g2o(path)
    with pytest.raises(DataError, match="cannot be read"):
        read_g2o(tmp_path / "absent.g2o")


@pytest.mark.parametrize("seed", range(20))
def test_damaged_bytes_give_one_line_or_a_graph(tmp_path: Path, seed) -> None:
    """Bytes overwritten, cut and doubled at random: never a traceback of another kind."""
    rng = np.random.default_rng(seed)
    data = bytearray((PLANE if seed % 2 else SPACE).encode())
    for _ in range(3):
        at = int(rng.integers(len(data)))
        kind = rng.integers(3)
        if kind == 0:
            data[at] = int(rng.integers(256))
        elif kind == 1:
            del data[at : at + int(rng.integers(1, 20))]
        else:
            data[at:at] = data[at : at + int(rng.integers(1, 40))]
    path = tmp_path / "damaged.g2o"
    path.write_bytes(bytes(data))
    try:
        graph = read_g2o(path)
    except DataError as error:
        assert "\n" not in str(error)
    else:
        assert np.isfinite(graph.T_world_scan).all()
