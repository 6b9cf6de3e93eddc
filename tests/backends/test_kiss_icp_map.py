"""KISS-ICP says only a pose: what we add to that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rbtm_bench.backends.base import MapLimits
from rbtm_bench.backends.kiss_icp import KissICP, KissMap
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


class Remembering:
    """A threshold that writes down what it is told."""

    def __init__(self) -> None:
        self.told: list[float] = []

    def get_threshold(self) -> float:
        return 0.2

    def update_model_deviation(self, deviation: np.ndarray) -> None:
        self.told.append(float(deviation[0, 3]))


def test_the_threshold_learns_from_the_last_registration_before_a_scan_is_added(
    scans: tuple[Scan, Scan],
) -> None:
    """Two candidates tried, one scan added: one deviation, of the second, and once."""
    backend = KissICP(0.3, map_voxel_size=0.1)
    source, target = (backend.prepare(scan) for scan in scans)
    running = backend.running_map(MapLimits(100.0, 100))
    assert isinstance(running, KissMap)
    threshold = Remembering()
    running.threshold = threshold
    running.insert(target, np.eye(4))
    assert threshold.told == [], "nothing was registered before the first scan"
    for x in (0.02, 0.07):
        backend.register(source, running.target(), se2(x, 0, 0))
    running.insert(source, se2(0.1, 0, 0))
    running.insert(source, se2(0.1, 0, 0))
    assert threshold.told == [pytest.approx(0.03, abs=0.01)]


def test_a_running_map_begins_with_the_library_s_own_ratios() -> None:
    """2 m for voxels of 1 m; 3 times that is the first correspondence distance, so that a scan 4 m
    from its guess is still met."""
    assert KissICP(0.3, map_voxel_size=1.0).initial_threshold == 2.0
    assert KissICP(0.3, map_voxel_size=1.0).min_motion_th == pytest.approx(0.1)
    running = KissICP(0.3, map_voxel_size=1.0).running_map(MapLimits(100.0, 100))
    assert isinstance(running, KissMap) and running.threshold.get_threshold() == 2.0


def test_a_scan_is_thinned_for_a_running_map_alone(scans: tuple[Scan, Scan]) -> None:
    native = KissICP(0.3, map_voxel_size=0.2).prepare(scans[0]).native
    assert len(native.kept) > len(native.thinned) > len(native.source)
    for points, cell in ((native.thinned, 0.1), (native.source, 0.3)):
        cells = np.floor(points / cell)
        assert len(np.unique(cells, axis=0)) == len(points), "two points in one cell"
