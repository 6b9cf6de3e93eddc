"""``voxel_size``: thinned once in ``prepare``, for every backend alike."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.backends.none import NoRegistration
from rbtm_bench.contract.scene import WORLDS
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import se2
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.odometry import judge


def scan(points: Array, planar: bool = False) -> Scan:
    return Scan(0, 0.0, points, planar)


def test_zero_keeps_every_point_as_it_is() -> None:
    points = WORLDS["2d"].scan(np.eye(4), 1, 0.01).points
    prepared = NoRegistration(0.3, voxel_size=0.0).prepare(scan(points))
    assert prepared.points.tobytes() == points.tobytes()


def test_each_voxel_becomes_the_mean_of_its_points() -> None:
    corner = np.array([[x, y, z] for x in (-1.0, 0.0) for y in (-1.0, 0.0) for z in (-1.0, 0.0)])
    points = np.concatenate([corner + 0.2, corner + 0.6])
    prepared = NoRegistration(0.3, voxel_size=1.0).prepare(scan(points))
    np.testing.assert_allclose(prepared.points, corner + 0.4, atol=1e-15)


def test_planar_points_stay_in_the_plane() -> None:
    points = WORLDS["2d"].scan(np.eye(4), 1, 0.01).points
    prepared = NoRegistration(0.3, voxel_size=0.2).prepare(scan(points, planar=True))
    assert prepared.planar and not prepared.points[:, 2].any()
    assert len(prepared.points) < len(points)


def test_no_voxel_holds_two_points() -> None:
    points = WORLDS["3d"].scan(np.eye(4), 1, 0.01).points
    prepared = NoRegistration(0.3, voxel_size=0.5).prepare(scan(points))
    voxels = {tuple(v) for v in np.floor(prepared.points / 0.5).astype(int).tolist()}
    assert len(voxels) == len(prepared.points)
    assert voxels == {tuple(v) for v in np.floor(points / 0.5).astype(int).tolist()}


def test_too_few_points_after_thinning_are_an_error() -> None:
    points = np.random.default_rng(0).uniform(0.1, 0.9, (100, 3))
    with pytest.raises(BackendError, match="1 points: expected at least 6"):
        NoRegistration(0.3, voxel_size=1.0).prepare(scan(points))


def test_fitness_counts_thinned_points() -> None:
    backend = NoRegistration(0.3, voxel_size=0.5)
    prepared = backend.prepare(WORLDS["3d"].scan(np.eye(4), 1, 0.01))
    result = judge.register(backend, prepared, prepared, np.eye(4))
    assert result.inliers == len(prepared.points)


def test_merging_thins_again_and_keeps_the_plane() -> None:
    backend = NoRegistration(0.3, voxel_size=0.2)
    prepared = backend.prepare(WORLDS["2d"].scan(np.eye(4), 1, 0.01))
    twice = backend.merge([(prepared, np.eye(4)), (prepared, np.eye(4))])
    np.testing.assert_allclose(twice.points, prepared.points, atol=1e-12)
    apart = backend.merge([(prepared, np.eye(4)), (prepared, se2(50, 0, 1))])
    assert apart.planar and not apart.points[:, 2].any()
    assert len(apart.points) > 1.5 * len(prepared.points)
