"""KISS-ICP as a system: its own numbers, its own defaults, and what it cannot say by itself."""

from __future__ import annotations

from dataclasses import replace

import cloud_helpers
import numpy as np
import pytest

from rbtm_bench.backends.kiss_icp_system import KissICPSystem
from rbtm_bench.core.errors import BackendError, ConfigError
from rbtm_bench.core.geometry import inverse, translation_norm
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.runs.settings import compose_settings

SCANS = 12


@pytest.fixture(scope="module")
def hall() -> tuple[list[Scan], Array]:
    """Clouds every 0.2 m, and their true poses from the first."""
    drive = cloud_helpers.hall(SCANS, 0.2)
    poses = drive.ground_truth
    return [Scan(s.index, s.stamp, s.points) for s in drive], inverse(poses[0]) @ poses


def follow(system: KissICPSystem, scans: list[Scan]) -> Array:
    tracker = system.start()
    return np.stack([tracker.track(scan).T_world_scan for scan in scans])


def test_defaults_are_the_library_s_own() -> None:
    from kiss_icp.config.parser import load_config

    ours, theirs = KissICPSystem().library_config(), load_config(None)
    assert ours.mapping == theirs.mapping
    assert ours.adaptive_threshold == theirs.adaptive_threshold
    assert ours.data == theirs.data.model_copy(update={"deskew": False})
    assert ours.registration == theirs.registration.model_copy(update={"max_num_threads": 1})


def test_the_library_s_environment_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    before = KissICPSystem().library_config()
    monkeypatch.setenv("KISS_ICP_MAPPING", '{"voxel_size": 9.0}')
    monkeypatch.setenv("KISS_ICP_OUT_DIR", "elsewhere")
    assert KissICPSystem().library_config() == before


def test_settings_scale_with_the_range_unless_given() -> None:
    config = KissICPSystem(max_range=4.0).library_config()
    assert config.mapping.voxel_size == pytest.approx(0.04)
    assert config.adaptive_threshold.initial_threshold == pytest.approx(0.08)
    assert config.adaptive_threshold.min_motion_th == pytest.approx(0.004)
    config = KissICPSystem(4.0, voxel_size=0.1, initial_threshold=1.0, min_motion_th=0.5)
    assert (config.voxel_size, config.initial_threshold, config.min_motion_th) == (0.1, 1.0, 0.5)
    with pytest.raises(ConfigError, match=r"min_range=5: expected less than max_range=4"):
        KissICPSystem(max_range=4.0, min_range=5.0)


def test_the_range_is_the_data_set_s() -> None:
    def reach(*words: str) -> object:
        settings = compose_settings(["backend=kiss_icp_system", *words])
        return settings.config["backend"]["max_range"]

    assert reach() == 4.0  # the corridor's
    assert reach("dataset=cloud_folder", "dataset.path=x") is None
    assert reach("dataset=cloud_folder", "dataset.path=x", "dataset.max_range=50.0") == 50.0
    assert reach("backend.max_range=7.0") == 7.0


def test_poses_are_those_of_register_frame(hall: tuple[list[Scan], Array]) -> None:
    from kiss_icp.kiss_icp import KissICP

    scans, _ = hall
    system = KissICPSystem()
    library = KissICP(system.library_config())
    expected = []
    for scan in scans:
        library.register_frame(scan.points, np.empty(0))
        expected.append(library.last_pose)
    np.testing.assert_array_equal(follow(system, scans), np.stack(expected))


def test_clouds_are_followed(hall: tuple[list[Scan], Array]) -> None:
    scans, truth = hall
    estimate = follow(KissICPSystem(), scans)
    # it sticks while it gets to know the speed, for the rings on the ground travel with the sensor
    late = inverse(inverse(truth[5]) @ truth[-1]) @ inverse(estimate[5]) @ estimate[-1]
    assert translation_norm(late) < 0.06  # of 1.2 m
    assert translation_norm(inverse(truth[-1]) @ estimate[-1]) < 0.3  # of 2.2 m


def test_planar_scans_are_followed_in_the_plane() -> None:
    data = Corridor(environment="cluttered", scans=41, path_length=4.0)
    estimate = follow(KissICPSystem(max_range=4.0), list(data))
    errors = translation_norm(inverse(inverse(data.ground_truth[0]) @ data.ground_truth) @ estimate)
    assert errors.max() < 0.04
    assert (estimate[:, 2] == [0, 0, 1, 0]).all() and (estimate[:, :, 2] == [0, 0, 1, 0]).all()


def test_a_repeated_scan_stands_still_and_is_no_mere_prediction() -> None:
    """Here the guess is the answer to the last bit, and the scan confirms it."""
    scan = Corridor(environment="cluttered", scans=2, range_noise=0.0)[0]
    tracker = KissICPSystem(max_range=4.0).start()
    for _ in range(3):
        tracked = tracker.track(scan)
        assert tracked.converged is None
        np.testing.assert_allclose(tracked.T_world_scan, np.eye(4), atol=1e-12)


def test_a_prediction_is_said_to_be_one(hall: tuple[list[Scan], Array]) -> None:
    scans, _ = hall
    tracker = KissICPSystem().start()
    first, second = (tracker.track(scan).T_world_scan for scan in scans[:2])
    thing = np.random.default_rng(0).normal(0.0, 0.3, (50, 3)) + np.array([0.0, 0.0, 60.0])
    strange = tracker.track(Scan(2, 0.2, thing))
    assert strange.converged is False
    predicted = second @ (inverse(first) @ second)
    np.testing.assert_allclose(strange.T_world_scan, predicted, atol=1e-9)


def test_too_few_points_within_range(hall: tuple[list[Scan], Array]) -> None:
    scans, _ = hall
    tracker = KissICPSystem(max_range=20.0, min_range=1.0).start()
    far = replace(scans[0], points=scans[0].points + np.array([500.0, 0.0, 0.0]))
    with pytest.raises(BackendError, match=r"scan 0: 0 points within 1 to 20 m: expected at least"):
        tracker.track(far)


def test_a_failing_library_is_an_error(
    hall: tuple[list[Scan], Array], monkeypatch: pytest.MonkeyPatch
) -> None:
    from kiss_icp.kiss_icp import KissICP

    def fail(*_: object) -> None:
        raise RuntimeError("out of luck")

    monkeypatch.setattr(KissICP, "register_frame", fail)
    with pytest.raises(BackendError, match="RuntimeError: out of luck"):
        KissICPSystem().start().track(hall[0][0])
