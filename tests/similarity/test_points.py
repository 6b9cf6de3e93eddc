"""Which points of a scan count, and how they lie in a descriptor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.datasets.kitti import Kitti
from rbtm_bench.similarity.mutual_neighbours import MutualNeighbours
from rbtm_bench.similarity.overlap import Overlap
from rbtm_bench.similarity.points import descriptor_of, inverse_of, moved, nearest, points_of, walk

NAN = float("nan")


def cloud(points: Array, planar: bool = False) -> Scan:
    return Scan(0, 0.0, np.asarray(points, dtype=float), planar)


def kept(similarity: Overlap, scan: Scan) -> Array:
    """The points of a scan's descriptor."""
    descriptor = similarity.describe(scan)
    assert descriptor.dtype == np.float32
    points, axis = points_of(descriptor)
    assert (np.diff(points[:, axis]) >= 0).all(), "sorted along the axis that it names"
    return points.astype(float)


def test_a_descriptor_by_hand() -> None:
    """y has the largest spread."""
    points = np.array([[1.0, 5.0, 0.5], [2.0, -4.0, 0.0]])
    expected = [2, 1, 2, -4, 0, 1, 5, 0.5, NAN, NAN, NAN]
    np.testing.assert_array_equal(descriptor_of(points, 3), np.float32(expected))
    np.testing.assert_array_equal(descriptor_of(np.zeros((0, 3)), 1), [0, 0, NAN, NAN, NAN])


def test_of_a_scan_with_beams_every_point_counts() -> None:
    scan = Corridor(scans=2, beams=91)[1]
    descriptor = Overlap(points=5, voxel_size=1.0, max_height_m=-3.0).describe(scan)
    assert descriptor.shape == (2 + 3 * 91,)
    points, _ = points_of(descriptor)
    expected = scan.points.astype(np.float32)
    assert sorted(map(tuple, points.tolist())) == sorted(map(tuple, expected.tolist()))


def test_more_points_than_beams_are_refused() -> None:
    scan = Scan(0, 0.0, np.zeros((3, 3)), True, np.ones(2), np.zeros(2))
    with pytest.raises(DataError, match="a scan of 2 beams has 3 points"):
        Overlap().describe(scan)


def test_of_a_cloud_a_height_band_counts() -> None:
    points = np.array([[0, 0, z] for z in (-0.6, -0.5, 0.0, 0.49, 0.5)])
    banded = kept(Overlap(min_height_m=-0.5, max_height_m=0.5), cloud(points))
    np.testing.assert_allclose(banded[:, 2], [-0.5, 0.0, 0.49], atol=1e-7)
    assert len(kept(Overlap(), cloud(points))) == 5
    assert len(kept(Overlap(min_height_m=0.0), cloud(points))) == 3
    flat = cloud(np.zeros((4, 3)), planar=True)
    assert len(kept(Overlap(min_height_m=1.0), flat)) == 4, "the plane has no height"


def test_a_cloud_is_averaged_in_voxels() -> None:
    points = np.array([[0.1, 0.1, 0.1], [0.3, 0.1, 0.1], [5.0, 0.2, 0.1]])
    means = kept(Overlap(voxel_size=1.0), cloud(points))
    np.testing.assert_allclose(means, [[0.2, 0.1, 0.1], [5.0, 0.2, 0.1]], atol=1e-6)


def test_of_many_points_evenly_many_count() -> None:
    points = np.column_stack([np.arange(10.0), np.zeros((10, 2))])
    sample = kept(Overlap(points=4), cloud(points))
    np.testing.assert_array_equal(sample[:, 0], [0, 2, 5, 7])
    assert len(kept(Overlap(points=10), cloud(points))) == 10


def test_an_upside_down_height_band_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"max_height_m=0.2: expected more than min_height_m=0.2"):
        MutualNeighbours(min_height_m=0.2, max_height_m=0.2)


@pytest.mark.parametrize("seed", range(20))
def test_nearest_is_the_nearest(seed) -> None:
    rng = np.random.default_rng(seed)
    points, axis = points_of(descriptor_of(rng.uniform(-1, 1, (40, 3)) * rng.uniform(0, 2, 3), 40))
    for query in rng.uniform(-1.5, 1.5, (30, 3)):
        place = walk(points, axis, query[axis], int(rng.integers(41)))
        assert (points[:place, axis] < query[axis]).all()
        assert (points[place:, axis] >= query[axis]).all()
        squares = ((points.astype(float) - query) ** 2).sum(axis=1)
        number, square = nearest(points, axis, *query, 0.4, place)
        if squares.min() < 0.4**2:
            assert number == np.argmin(squares)
            assert square == pytest.approx(squares.min(), rel=1e-12)
        else:
            assert (number, square) == (-1, 0.4**2)


def test_motions_in_space_are_inverted() -> None:
    T = np.array([[0.0, -1, 0, 3], [0, 0, -1, 4], [1, 0, 0, 5], [0, 0, 0, 1]])
    np.testing.assert_array_equal(inverse_of(T), np.linalg.inv(T))
    assert moved(T, np.float32([1, 2, 3])) == (1.0, 1.0, 6.0)


@pytest.mark.parametrize("similarity", [Overlap(1.0), MutualNeighbours(1.0)], ids=["o", "m"])
def test_half_a_matrix_is_the_whole(similarity) -> None:
    drive = Corridor(scans=25, beams=61)
    descriptors = np.stack([similarity.describe(scan) for scan in drive])
    matrix = similarity.matrix(descriptors)
    assert matrix.tobytes() == similarity.pairwise(descriptors, descriptors).tobytes()


@pytest.mark.parametrize("kind", [Overlap, MutualNeighbours])
def test_on_the_road_the_true_motion_scores_highest(data_dir: Path, kind) -> None:
    """Frames 14 to 19, whose poses hold (see the data's README), 0.9 to 4.5 m apart: a guess
    2 m or 6 deg off scores lower."""
    from rbtm_bench.core.geometry import inverse, se2

    drive = Kitti(str(data_dir / "kitti"), max_scans=20)
    similarity = kind(1.0, voxel_size=0.5, min_height_m=0.0, max_height_m=2.0)
    scans = [drive[i] for i in range(14, 20)]
    descriptors = np.stack([similarity.describe(scan) for scan in scans])
    poses = np.stack([scan.ground_truth for scan in scans])
    motions = inverse(poses[:-1]) @ poses[-1]
    true = similarity.scores_under(descriptors[:-1], descriptors[-1], motions)
    for off in (se2(2, 0, 0), se2(0, 2, 0), se2(0, 0, 0.1), se2(-2, 0, 0)):
        wrong = similarity.scores_under(descriptors[:-1], descriptors[-1], motions @ off)
        assert (wrong < true - 0.1).all()
    assert (true > similarity.scores(descriptors[:-1], descriptors[-1]))[:3].all(), "nor none"
