"""KISS-ICP says only a pose: what we add to that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rbtm_bench.backends.kiss_icp import KissICP
from rbtm_bench.contract.scene import WORLDS
from rbtm_bench.core.geometry import se2, transform
from rbtm_bench.core.types import Scan
from rbtm_bench.odometry import judge


@pytest.fixture(scope="module")
def scans() -> tuple[Scan, Scan]:
    """Source and target, 0.1 m apart."""
    world = WORLDS["2d"]
    return world.scan(world.start @ se2(0.1, 0, 0), 1, 0.0), world.scan(world.start, 2, 0.0)


def test_a_map_far_away_is_not_converged_and_not_faked(scans: tuple[Scan, Scan]) -> None:
    source, target = scans
    backend, guess = KissICP(0.3), se2(0.02, 0.01, 0.01)
    far = replace(target, points=target.points + np.array([500.0, 0.0, 0.0]))
    result = judge.register(backend, backend.prepare(source), backend.prepare(far), guess)
    assert result.converged is False
    assert (result.fitness, result.inliers) == (0.0, 0)
    assert np.isnan(result.inlier_rmse)


def test_what_the_library_does_not_say_is_none(scans: tuple[Scan, Scan]) -> None:
    backend = KissICP(0.3)
    source, target = (backend.prepare(scan) for scan in scans)
    result = judge.register(backend, source, target, np.eye(4))
    assert result.converged is None and result.iterations is None
    assert result.library_fitness is None and result.library_rmse is None
    assert result.fitness > 0.9


def test_the_map_reaches_as_far_as_the_correspondence_distance(scans: tuple[Scan, Scan]) -> None:
    """0.4 m away with a distance of 0.5 m: in reach only if the map's voxels are that large."""
    source, target = scans
    backend = KissICP(0.5)
    moved = replace(target, points=transform(se2(0.3, 0.0, 0.0), target.points))
    result = judge.register(backend, backend.prepare(source), backend.prepare(moved), np.eye(4))
    np.testing.assert_allclose(result.T_target_source, se2(0.4, 0, 0), atol=0.02)


def test_defaults_follow_the_correspondence_distance() -> None:
    backend = KissICP(0.6)
    assert backend.kernel == pytest.approx(0.2)
    assert backend.map_voxel_size == 0.6
    assert KissICP(0.6, kernel=0.05, map_voxel_size=1.0).kernel == 0.05


def test_the_map_keeps_points_of_the_scan(scans: tuple[Scan, Scan]) -> None:
    prepared = KissICP(0.3).prepare(scans[0])
    given = {tuple(point) for point in prepared.points.tolist()}
    assert {tuple(point) for point in prepared.native.kept.tolist()} <= given
    sparse = KissICP(0.3, max_points_per_voxel=1).prepare(scans[0])
    assert len(sparse.native.kept) < len(prepared.native.kept)
