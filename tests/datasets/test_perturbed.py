"""Perturbed copies of a data set: bounded, drawn from seed and number alone, consistent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rbtm_bench.core.geometry import inverse, is_rigid, rotation_angle, translation_norm
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import Dataset, Relations
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.datasets.noise_estimate import (
    OdometryError,
    beam_residuals,
    odometry_error,
    plane_residuals,
    range_noise,
)
from rbtm_bench.datasets.perturbed import LARGEST, Amounts, Perturbed, Since, jittered, measured

PLAIN = Corridor(scans=61)
seeds = st.integers(0, 2**31)
numbers = st.integers(1, 50)


def copy(number: int = 1, seed: int = 0, **amounts: float) -> Perturbed:
    return Perturbed(PLAIN, seed, number, replace(Amounts(), **amounts))


class Clouds(Dataset):
    """Points without beams, odometry or truth: three walls seen with 10 mm of noise."""

    def __len__(self) -> int:
        return 40

    def __getitem__(self, index: int) -> Scan:
        rng = np.random.default_rng(index)
        points = rng.uniform(2.0, 6.0, (900, 3))
        points[np.arange(900), np.arange(900) % 3] = 2.0
        points += 0.01 * rng.standard_normal(points.shape)
        return Scan(index, 0.1 * index, points)

    def fingerprint(self) -> str:
        return "clouds"


@settings(max_examples=20, deadline=None)
@given(seeds, numbers)
def test_ranges_stay_within_three_deviations_and_points_on_their_beams(seed: int, n: int) -> None:
    made = copy(n, seed)
    assert made.sigma <= measured(PLAIN).range_noise / 3
    scan, plain = made[3], PLAIN[3 + made.first]
    assert scan.ranges is not None and plain.ranges is not None and scan.angles is not None
    assert np.array_equal(np.isnan(scan.ranges), np.isnan(plain.ranges))
    assert np.nanmax(np.abs(scan.ranges - plain.ranges)) <= LARGEST * made.sigma + 1e-12
    hit = np.isfinite(scan.ranges)
    assert np.allclose(np.linalg.norm(scan.points, axis=1), scan.ranges[hit])
    bearing = np.arctan2(scan.points[:, 1], scan.points[:, 0])
    assert np.allclose(bearing, scan.angles[hit])


@settings(max_examples=20, deadline=None)
@given(seeds, numbers, st.booleans())
def test_jitter_leaves_the_odometry_rigid_and_pairs_consistent(
    seed: int, n: int, planar: bool
) -> None:
    rng = np.random.default_rng([seed, n])
    error = OdometryError(0.05, 0.02, 0.002, "truth")
    poses = jittered(PLAIN.odometry, error, 0.1, planar, rng)
    assert all(is_rigid(T, 1e-9) for T in poses)
    i, j, k = 5, 20, 44
    pair = lambda a, b: inverse(poses[a]) @ poses[b]  # noqa: E731
    assert np.allclose(pair(i, j) @ pair(j, i), np.eye(4), atol=1e-12)
    assert np.allclose(pair(i, j) @ pair(j, k), pair(i, k), atol=1e-12)
    steps = [inverse(T[:-1]) @ T[1:] for T in (PLAIN.odometry, poses)]
    off = inverse(steps[0]) @ steps[1]
    limit = LARGEST * 0.1 * 0.05 * translation_norm(steps[0])
    assert (translation_norm(off) <= np.sqrt(3) * limit + 1e-12).all()
    assert rotation_angle(off).max() <= np.sqrt(3) * LARGEST * 0.1 * 0.0021
    if planar:
        assert np.array_equal(poses[:, 2], PLAIN.odometry[:, 2])


def test_copies_depend_on_seed_number_and_data_alone() -> None:
    assert np.array_equal(copy(2)[7].points, copy(2)[7].points)
    for other in (copy(3), copy(2, seed=1)):
        assert copy(2).fingerprint() != other.fingerprint() != PLAIN.fingerprint()
        assert not np.array_equal(copy(2)[9].points, other[9].points)
    # whatever else is perturbed, the noise is the same
    alone = copy(2, odometry=0.0)
    assert np.array_equal(alone[7].points, copy(2)[7].points)
    assert np.array_equal(alone[7].odometry, PLAIN[7 + alone.first].odometry)


def test_a_copy_begins_within_the_first_scans_and_all_are_scored_from_one() -> None:
    made = [copy(n) for n in range(1, 30)]
    latest = 61 // 20  # of a short log a twentieth, not ten scans
    assert {one.first for one in made} == set(range(latest + 1))
    assert {one.first + one.scored_from for one in made} == {latest}
    for one in made[:5]:
        assert len(one) == 61 - one.first and one[0].index == 0
        assert one[one.scored_from].stamp == PLAIN[latest].stamp
    assert copy(1, start_scans=0).first == 0


def test_nothing_perturbed_is_the_data_as_they_are() -> None:
    same = copy(1, ranges=0.0, odometry=0.0, start_scans=0)
    for one, plain in zip(same, PLAIN, strict=True):
        assert np.array_equal(one.points, plain.points)
        assert np.array_equal(one.odometry, plain.odometry)


def test_points_without_beams_move_along_their_rays() -> None:
    clouds = Clouds()
    made = Perturbed(clouds, 0, 1, Amounts())
    assert made.draw is not None and made.draw["odometry_error"] is None
    assert 0.005 < made.draw["sensor_noise_m"] < 0.02
    points, plain = made[0].points, clouds[made.first].points
    assert np.allclose(np.cross(points, plain), 0.0, atol=1e-12)
    moved = np.linalg.norm(points - plain, axis=1)
    assert 0 < moved.max() <= LARGEST * made.sigma + 1e-12


def test_a_copy_begins_after_the_last_scan_at_rest() -> None:
    class Waits(Clouds):
        has_ground_truth = True

        def __getitem__(self, index: int) -> Scan:
            T = np.eye(4)
            T[0, 3] = max(0, index - 12) * 0.1
            return replace(super().__getitem__(index), ground_truth=T)

    common = measured(Waits())
    assert common.begins == 12 and common.latest_start(Amounts()) == 12 + 28 // 20


def test_without_its_first_scans_a_data_set_is_numbered_anew() -> None:
    since = Since(PLAIN, 3)
    assert [scan.index for scan in since] == list(range(58)) and since.planar
    assert since.fingerprint() != PLAIN.fingerprint()
    with pytest.raises(IndexError):
        since[58]


# --- estimates


@pytest.mark.parametrize("noise", [0.005, 0.02])
def test_range_noise_is_found_on_walls_and_edges(noise: float) -> None:
    assert range_noise(Corridor(range_noise=noise)) == pytest.approx(noise, rel=0.05)
    assert range_noise(Corridor(range_noise=0.0)) < 1e-6  # single precision of the rays


def test_a_slanted_wall_has_no_second_difference() -> None:
    angles = np.deg2rad(np.arange(0.0, 60.0))
    assert np.abs(beam_residuals(2.0 / np.cos(angles - 0.3), angles)).max() < 1e-12
    assert len(beam_residuals(np.array([1.0, np.nan, 1.0, 9.0, 1.0]), angles[:5])) == 0
    assert len(plane_residuals(np.zeros((5, 3)))) == 0


def track(**noise: float) -> tuple[Array, Array, Array]:
    drive = Corridor(environment="l_turn", scans=400, **noise)
    return 0.1 * np.arange(400), drive.odometry, drive.ground_truth


def test_the_odometrys_error_is_found_by_truth_and_by_relations() -> None:
    noise = {"odometry_noise_translation": 0.04, "odometry_noise_rotation_deg": 0.2}
    stamps, odometry, truth = track(**noise)
    by_truth = odometry_error(stamps, odometry, truth, None)
    start, end = stamps[:-3], stamps[3:]
    relations = Relations(start, end, inverse(truth[:-3]) @ truth[3:])
    by_relations = odometry_error(stamps, odometry, None, relations)
    for error, source in ((by_truth, "truth"), (by_relations, "relations")):
        assert error.source == source and error.rotation == 0.0
        assert error.translation == pytest.approx(0.04, rel=0.3)
        assert error.rotation_rad == pytest.approx(np.deg2rad(0.2), rel=0.2)


def test_without_anything_to_measure_it_by_the_error_is_stated() -> None:
    stamps, odometry, truth = track()
    few = Relations(stamps[:5], stamps[1:6], inverse(truth[:5]) @ truth[1:6])
    for relations in (None, few):
        error = odometry_error(stamps, odometry, None, relations)
        assert error == OdometryError(0.02, 0.02, 0.0, "default")
