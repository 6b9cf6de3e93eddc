"""The simulated corridor: ranges by hand, independent noise, and what it is to show."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.geometry import inverse, se2, to_plane, translation_norm, yaw
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.corridor import Corridor, noisy_odometry
from rbtm_bench.datasets.environments import ENVIRONMENTS

SMALL: dict[str, Any] = {"scans": 5, "beams": 61}

PATH_ENDS = {
    "paper": se2(1.8, 0, 0),
    "bare": se2(20, 0, 0),
    "cluttered": se2(6, 0, 0),
    "l_turn": se2(4, 4, np.pi / 2),
}


def test_ranges_by_hand() -> None:
    """At x = 0.5 a recess of 0.3 m is on the right, plain wall on the left, the end at x = 5."""
    settings: dict[str, Any] = {"scans": 3, "path_length": 1.0, "beams": 3, "range_noise": 0.0}
    near = Corridor(**settings, field_of_view_deg=180.0)[1]
    np.testing.assert_allclose(near.ranges, [1.3, np.nan, 1.0], atol=1e-6)
    np.testing.assert_allclose(near.points, [[0, -1.3, 0], [0, 1.0, 0]], atol=1e-6)
    far = Corridor(**settings, field_of_view_deg=180.0, max_range=5.0)[1]
    np.testing.assert_allclose(far.ranges, [1.3, 4.5, 1.0], atol=1e-6)


def test_defaults_are_the_paper_s_laser() -> None:
    scan = Corridor()[180]
    assert scan.angles is not None and scan.ranges is not None and scan.ground_truth is not None
    assert scan.ranges.shape == (681,)
    assert np.rad2deg(scan.angles[[0, 340, 680]]) == pytest.approx([-120, 0, 120])
    assert np.nanmax(scan.ranges) < 4.05
    assert scan.stamp == pytest.approx(18.0)
    np.testing.assert_allclose(scan.ground_truth, se2(1.8, 0, 0), atol=1e-12)


@pytest.mark.parametrize("environment", sorted(ENVIRONMENTS))
def test_every_environment(environment: Any) -> None:
    drive = Corridor(environment=environment, scans=50, field_of_view_deg=360.0, range_noise=0.0)
    np.testing.assert_allclose(drive.ground_truth[0], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(drive.ground_truth[-1], PATH_ENDS[environment], atol=1e-9)
    assert np.nanmin(drive.ranges) > 0.3, "the robot would hit a wall"
    steps = translation_norm(inverse(drive.ground_truth[:-1]) @ drive.ground_truth[1:])
    np.testing.assert_allclose(steps, ENVIRONMENTS[environment].default_length / 49, rtol=0.01)


def test_in_the_bare_corridor_every_scan_is_the_same() -> None:
    ranges = Corridor(environment="bare", scans=20, range_noise=0.0).ranges
    np.testing.assert_allclose(ranges, np.tile(ranges[0], (20, 1)), atol=1e-4)


def test_the_turn_follows_its_circle() -> None:
    """A quarter circle of radius 1 m around (3, 1), halfway."""
    place = ENVIRONMENTS["l_turn"]
    pose = place.poses(np.array([3.0 + np.pi / 4]))[0]
    half = np.sqrt(0.5)
    np.testing.assert_allclose(pose, se2(3 + half, 1 - half, np.pi / 4), atol=1e-12)


def test_range_noise_has_the_wanted_spread() -> None:
    exact, noisy = Corridor(range_noise=0.0), Corridor(range_noise=0.02)
    noise = (noisy.ranges - exact.ranges)[np.isfinite(exact.ranges)]
    assert noise.mean() == pytest.approx(0.0, abs=3e-4)
    assert noise.std() == pytest.approx(0.02, rel=0.02)


def test_odometry_noise_has_the_wanted_spread() -> None:
    poses = np.stack([se2(0.2 * i, 0, 0) for i in range(20_001)])
    odometry = noisy_odometry(poses, 0.05, 0.002, np.random.default_rng(0))
    steps = inverse(odometry[:-1]) @ odometry[1:]
    assert (steps[:, 0, 3] - 0.2).std() == pytest.approx(0.01, rel=0.05)
    assert steps[:, 1, 3].std() == pytest.approx(0.01, rel=0.05)
    assert yaw(steps).std() == pytest.approx(0.002, rel=0.05)


def test_odometry_without_noise_is_the_path() -> None:
    drive = Corridor(
        environment="l_turn", odometry_noise_translation=0, odometry_noise_rotation_deg=0, **SMALL
    )
    np.testing.assert_allclose(drive.odometry, drive.ground_truth, atol=1e-12)


def test_ranges_and_odometry_have_random_streams_of_their_own() -> None:
    base = Corridor(**SMALL)
    other_odometry = Corridor(odometry_noise_translation=0.2, **SMALL)
    other_ranges = Corridor(range_noise=0.1, **SMALL)
    np.testing.assert_array_equal(base.ranges, other_odometry.ranges)
    np.testing.assert_array_equal(base.odometry, other_ranges.odometry)
    assert not np.array_equal(base.odometry, other_odometry.odometry)


def test_the_seed_decides() -> None:
    again, other = Corridor(seed=3, **SMALL), Corridor(seed=4, **SMALL)
    np.testing.assert_array_equal(Corridor(seed=3, **SMALL).ranges, again.ranges)
    np.testing.assert_array_equal(Corridor(seed=3, **SMALL).odometry, again.odometry)
    assert not np.array_equal(again.ranges, other.ranges, equal_nan=True)
    assert not np.array_equal(again.odometry, other.odometry)


@pytest.mark.parametrize(
    "change",
    [
        {"environment": "bare"},
        {"scans": 6},
        {"path_length": 1.0},
        {"beams": 62},
        {"field_of_view_deg": 180.0},
        {"max_range": 3.0},
        {"range_noise": 0.0},
        {"seed": 1},
        {"odometry_noise_translation": 0.0},
        {"odometry_noise_rotation_deg": 0.0},
    ],
)
def test_every_setting_is_in_the_fingerprint(change: dict[str, Any]) -> None:
    base = Corridor(**SMALL).fingerprint()
    assert (
        base == Corridor(**SMALL).fingerprint() == Corridor(path_length=1.8, **SMALL).fingerprint()
    )
    assert base != Corridor(**{**SMALL, **change}).fingerprint()


def test_settings_that_cannot_be_met() -> None:
    with pytest.raises(ConfigError, match=r"path_length=21 m: .* is 20 m long"):
        Corridor(environment="bare", path_length=21.0, **SMALL)
    with pytest.raises(ConfigError, match="expected one of paper, bare"):
        Corridor(environment="moon", **SMALL)  # type: ignore[arg-type]


@pytest.mark.parametrize("index", [-1, 5])
def test_there_is_no_scan_before_the_first_or_after_the_last(index: int) -> None:
    with pytest.raises(IndexError):
        Corridor(**SMALL)[index]


def _final_error(drive: Corridor, model_of: Callable[[int], int]) -> float:
    """Distance in m from the true end, of point-to-point ICP with a constant-velocity guess."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(scan.points)) for scan in drive]
    path: list[Array] = [np.eye(4), np.eye(4)]
    for scan in range(1, len(drive)):
        model = model_of(scan)
        motion = inverse(path[-2]) @ path[-1]
        result = registration.registration_icp(
            clouds[scan],
            clouds[model],
            0.3,
            inverse(path[model + 1]) @ path[-1] @ motion,
            registration.TransformationEstimationPointToPoint(),
        )
        # Rounding must not add up: inverse() takes rotations to be exact.
        path.append(to_plane(path[model + 1] @ result.transformation))
    truth = inverse(drive.ground_truth[0]) @ drive.ground_truth[-1]
    return float(translation_norm(inverse(truth) @ path[-1]))


def test_point_to_point_sticks_in_the_paper_s_corridor() -> None:
    """Why this data set exists: the previous scan is a bad model scan, an older one a good one."""
    drive = Corridor()
    previous = _final_error(drive, lambda scan: scan - 1)
    older = _final_error(drive, lambda scan: max(0, scan - 30))
    assert 0.4 < previous < 1.8
    assert older < previous / 15
