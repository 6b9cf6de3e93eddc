"""Polar scan matching: its two steps by hand, and what it is for, large rotations."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.backends.base import Backend
from rbtm_bench.backends.open3d_p2p import Open3DPointToPoint
from rbtm_bench.backends.polar_scan import bins_of
from rbtm_bench.backends.psm import PolarScanMatching, orientation, translation
from rbtm_bench.contract.scene import WORLDS, cast, outline, planar_scan
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import inverse, rotation_angle, se2, transform, translation_norm, yaw
from rbtm_bench.core.types import Array, RegistrationResult, Scan
from rbtm_bench.datasets.base import beam_points
from rbtm_bench.datasets.environments import ENVIRONMENTS
from rbtm_bench.datasets.raycast import scan_walls
from rbtm_bench.odometry import judge

BEARINGS = np.deg2rad(np.arange(360.0))
BINS = bins_of(np.column_stack([np.cos(BEARINGS), np.sin(BEARINGS)]), 360)
ROOM_LIKE = 4.0 + np.sin(2 * BEARINGS) + 0.6 * np.cos(5 * BEARINGS + 1.0)
FORWARD = np.deg2rad(np.linspace(-90, 90, 181))
AROUND = np.deg2rad(np.arange(-180.0, 180.0))


def place_scan(place: str, T: Array, index: int, angles: Array, noise: float = 0.01) -> Scan:
    """A scan of a simulated place; nothing beyond 30 m."""
    ranges = scan_walls(ENVIRONMENTS[place].walls, T[None], angles, 30.0)[0]
    ranges = ranges + noise * np.random.default_rng(index).standard_normal(len(ranges))
    return Scan(index, 0.0, beam_points(ranges, angles), True)


def register(
    method: Backend, source: Scan, target: Scan, guess: Array | None = None
) -> RegistrationResult:
    prepared, model = method.prepare(source), method.prepare(target)
    return judge.register(method, prepared, model, np.eye(4) if guess is None else guess)


def off(result: RegistrationResult, truth: Array) -> tuple[float, float]:
    """m and deg from the truth."""
    error = inverse(truth) @ result.T_target_source
    return float(translation_norm(error)), float(np.degrees(rotation_angle(error)))


def is_found(result: RegistrationResult, truth: Array) -> bool:
    metres, degrees = off(result, truth)
    return metres < 0.05 and degrees < 1.0


# ---- the two steps ------------------------------------------------------------------------------


@pytest.mark.parametrize("bins", [0, 1, -7, 20])
def test_a_shift_of_whole_bins_is_found_exactly(bins: int) -> None:
    reference = np.roll(ROOM_LIKE, bins)
    assert orientation(np.tile(reference, 2), ROOM_LIKE, 20.0, 1.0) == pytest.approx(bins, abs=0.05)


@pytest.mark.parametrize("share", [-0.3, 0.25, 0.5])
def test_a_part_of_a_bin_is_found_by_the_parabola(share: float) -> None:
    step = np.deg2rad(1.0)
    reference = 4.0 + np.sin(2 * (BEARINGS - share * step))
    current = 4.0 + np.sin(2 * BEARINGS)
    assert orientation(np.tile(reference, 2), current, 20.0, 1.0) == pytest.approx(share, abs=0.1)


def test_a_shift_out_of_the_window_is_not_looked_for() -> None:
    reference = np.roll(ROOM_LIKE, 30)
    assert orientation(np.tile(reference, 2), ROOM_LIKE, 20.0, 1.0) <= 20.0
    assert orientation(np.tile(reference, 2), ROOM_LIKE, 40.0, 1.0) == pytest.approx(30, abs=0.05)


def test_a_few_large_differences_do_not_outvote_the_rest() -> None:
    """A doorway through which one scan sees 40 m: 8 bins against 352."""
    reference, current = np.roll(ROOM_LIKE, 6), ROOM_LIKE.copy()
    current[50:58] = 40.0
    reference[45:53] = 40.0  # moved the other way, as a parallax does
    twice = np.tile(reference, 2)
    assert orientation(twice, current, 20.0, 1.0) == pytest.approx(6, abs=0.1)
    assert abs(orientation(twice, current, 20.0, 1e9) - 6) > 5  # the papers' own mean


def test_too_little_in_common_is_no_shift() -> None:
    reference, current = np.full(360, np.inf), np.full(360, np.inf)
    reference[:90], current[180:270] = 3.0, 3.0
    assert np.isnan(orientation(np.tile(reference, 2), current, 20.0, 1.0))
    current[60:150] = 3.0  # 30 of 90 or more bins
    assert not np.isnan(orientation(np.tile(reference, 2), current, 20.0, 1.0))


def test_a_translation_moves_points_along_their_beams() -> None:
    """dr = cos(b) dx + sin(b) dy is undone exactly, whatever the weights."""
    dr = 0.05 * np.cos(BEARINGS) - 0.02 * np.sin(BEARINGS)
    shift = translation(ROOM_LIKE, ROOM_LIKE - dr, BINS, 0.49, 1.0)
    np.testing.assert_allclose(shift, (0.05, -0.02), atol=1e-12)


def test_weights_are_c_over_c_plus_dr_squared() -> None:
    """Two beams ahead disagree: (w1 0.1 + w2 0.3) / (w1 + w2), a third holds y."""
    reference = np.full(360, np.inf)
    ranges = np.full(360, np.inf)
    for b, dr in ((0, 0.1), (180, -0.3), (90, 0.0), (270, 0.0), (1, 0.1), (359, 0.1)):
        reference[b], ranges[b] = 3.0, 3.0 - dr
    C = 0.04
    w1, w2, c = C / (C + 0.01), C / (C + 0.09), np.cos(np.deg2rad(1))
    expected = (w1 * 0.1 * (1 + 2 * c) + w2 * 0.3) / (w1 * (1 + 2 * c * c) + w2)
    assert translation(reference, ranges, BINS, C, 1.0)[0] == pytest.approx(expected)


def test_differences_from_max_error_on_do_not_count() -> None:
    dr = 0.05 * np.cos(BEARINGS)
    ranges = ROOM_LIKE - dr
    ranges[10:40] -= 0.5
    np.testing.assert_allclose(
        translation(ROOM_LIKE, ranges, BINS, 0.49, 0.4), (0.05, 0), atol=1e-9
    )
    assert translation(ROOM_LIKE, ranges, BINS, 0.49, 1.0)[0] > 0.06


def test_parallel_beams_hold_no_translation() -> None:
    ranges = np.full(360, np.inf)
    ranges[[0, 180]] = 3.0
    assert np.isnan(translation(ranges, ranges, BINS, 0.49, 1.0)[0])


# ---- what it is for -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("place", "angles", "degrees", "shift", "for_icp"),
    [
        ("cluttered", FORWARD, 20.0, 20.0, 6),
        ("l_turn", FORWARD, 30.0, 20.0, 4),
        ("paper", FORWARD, 40.0, 20.0, 3),
        ("cluttered", AROUND, 40.0, 45.0, 1),
        ("cluttered", AROUND, 60.0, 45.0, 0),
    ],
)
def test_large_rotations_are_found_without_a_guess(
    place: str, angles: Array, degrees: float, shift: float, for_icp: int
) -> None:
    """0.2 m and a rotation that point-to-point ICP mostly does not find: of 12 pairs."""
    random = np.random.default_rng(3)
    polar = PolarScanMatching(0.5, max_orientation_shift=shift)
    icp = Open3DPointToPoint(0.5)
    by_psm = by_icp = 0
    for k, along in enumerate(np.linspace(0.2, 3.5, 12)):
        start = ENVIRONMENTS[place].poses(np.array([along]))[0]
        heading, sign = random.uniform(-np.pi, np.pi), random.choice((-1, 1))
        T = se2(0.2 * np.cos(heading), 0.2 * np.sin(heading), sign * np.deg2rad(degrees))
        source = place_scan(place, start @ T, 2 * k, angles)
        target = place_scan(place, start, 2 * k + 1, angles)
        by_psm += is_found(register(polar, source, target), T)
        by_icp += is_found(register(icp, source, target), T)
    assert by_psm >= 11
    assert by_icp <= for_icp


def test_a_wider_search_finds_any_rotation() -> None:
    method = PolarScanMatching(0.5, max_orientation_shift=180.0)
    for k, degrees in enumerate(range(-180, 180, 30)):
        T = se2(0.2, -0.1, np.deg2rad(degrees))
        start = se2(0.5, -0.4, 0.3)
        source, target = planar_scan(start @ T, k, 0.01), planar_scan(start, 50 + k, 0.01)
        assert is_found(register(method, source, target), T), f"{degrees} deg"


def test_a_right_guess_is_kept() -> None:
    T = se2(0.6, 0.3, np.deg2rad(70))
    start = se2(0.3, -0.2, 0.2)
    source, target = planar_scan(start @ T, 1, 0.01), planar_scan(start, 2, 0.01)
    result = register(PolarScanMatching(0.5), source, target, T)
    assert off(result, T) < (0.01, 0.3)
    assert result.converged


def test_merged_scans_are_seen_as_one_scan_would_see_them() -> None:
    """Five scans from up to 0.8 m apart have finer bearings than one; near walls hide far ones."""
    method = PolarScanMatching(0.5)
    place = [se2(0.2 * k, 0.05 * k, 0.1 * k) for k in range(5)]
    start = se2(0.0, -0.5, 0.1)
    scans = [method.prepare(planar_scan(start @ T, k, 0.01)) for k, T in enumerate(place)]
    merged = method.merge(list(zip(scans, place, strict=True)))
    assert len(merged.native.bins.cosine) > 600
    T = se2(0.4, 0.1, np.deg2rad(25))
    source = method.prepare(planar_scan(start @ T, 9, 0.01))
    assert off(judge.register(method, source, merged, np.eye(4)), T) < (0.01, 0.3)


@pytest.mark.parametrize("voxel_size", [0.05, 0.1])
def test_thinned_scans_still_match(voxel_size: float) -> None:
    T = se2(0.15, -0.1, np.deg2rad(15))
    start = se2(0.3, -0.2, 0.2)
    source, target = planar_scan(start @ T, 1, 0.01), planar_scan(start, 2, 0.01)
    result = register(PolarScanMatching(0.5, voxel_size), source, target)
    assert off(result, T) < (0.02, 0.5)


def test_the_number_of_bins_can_be_chosen() -> None:
    T = se2(0.1, -0.1, np.deg2rad(12))
    start = se2(0.3, -0.2, 0.2)
    source, target = planar_scan(start @ T, 1), planar_scan(start, 2)
    for bins in (180, 360, 720):
        method = PolarScanMatching(0.5, bins=bins)
        assert len(method.prepare(target).native.ranges) == bins
        assert off(register(method, source, target), T) < (0.02, 0.5)


# ---- stopping, failing, uncertainty -------------------------------------------------------------


def test_three_small_corrections_end_the_search() -> None:
    scan = planar_scan(se2(0.3, -0.2, 0.2), 1, 0.01)
    result = register(PolarScanMatching(0.5), scan, scan)
    assert result.iterations == 3
    assert result.converged


def test_not_settled_is_not_converged() -> None:
    world = WORLDS["2d"]
    source, target = world.pair(world.motions["curve"], 0.01)
    result = register(PolarScanMatching(0.5, max_iterations=4), source, target)
    assert result.iterations == 4
    assert result.converged is False


def test_steps_that_turn_back_shrink() -> None:
    """Beside walls seen at an angle the papers' own steps go too far: in a corridor seen forwards
    they swing to and fro, and settle far less often."""
    random = np.random.default_rng(1)
    walls = outline((-30, -1.2), (40, -1.2), (40, 1.2), (-30, 1.2))
    settled = {1.0: 0, 0.5: 0}
    for k in range(20):
        start = se2(1.0 + 0.3 * k, random.uniform(-0.4, 0.4), random.uniform(-0.2, 0.2))
        T = se2(*random.uniform((0.3, -0.15, -0.15), (0.8, 0.15, 0.15)))
        scans = []
        for index, pose in ((2 * k, start @ T), (2 * k + 1, start)):
            ranges = cast(walls, pose, FORWARD)
            ranges += 0.01 * np.random.default_rng(index).standard_normal(len(ranges))
            points = beam_points(np.where(ranges < 30.0, ranges, np.nan), FORWARD)
            scans.append(Scan(index, 0.0, points, True))
        for backtracking in settled:
            method = PolarScanMatching(0.5, backtracking=backtracking)
            result = register(method, *scans, T @ se2(0.05, -0.03, 0.03))
            settled[backtracking] += bool(result.converged)
    assert settled[0.5] >= 17
    assert settled[1.0] <= 13


def test_nothing_in_common_is_not_converged() -> None:
    world = WORLDS["2d"]
    source, target = world.pair(world.motions["still"])
    guess = se2(40.0, 0.0, 0.0)
    result = register(PolarScanMatching(0.5), source, target, guess)
    assert result.converged is False


def test_points_without_surface_are_an_error() -> None:
    random = np.random.default_rng(0)
    turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ranges = random.permutation(np.linspace(1, 12, 12))
    points = beam_points(ranges, turn)
    with pytest.raises(BackendError, match="surface"):
        PolarScanMatching(bins=360).prepare(Scan(0, 0.0, points, True))
    near = planar_scan(np.eye(4))
    with pytest.raises(BackendError, match="surface"):
        PolarScanMatching(max_range=0.2).prepare(near)


def test_clouds_in_space_are_refused() -> None:
    points = np.random.default_rng(0).standard_normal((100, 3))
    with pytest.raises(BackendError, match="planar"):
        PolarScanMatching().prepare(Scan(0, 0.0, points, False))


def test_the_information_is_that_of_the_errors() -> None:
    """Over 40 noisy pairs the errors spread as predicted, within a factor of 2; no bias counted."""
    method = PolarScanMatching(0.5)
    T, start = se2(0.1, -0.05, 0.05), se2(2.0, 0.0, 0.0)
    errors, predicted = [], []
    for k in range(40):
        source = place_scan("cluttered", start @ T, 2 * k, FORWARD)
        result = register(method, source, place_scan("cluttered", start, 2 * k + 1, FORWARD))
        error = inverse(T) @ result.T_target_source
        errors.append([error[0, 3], error[1, 3], yaw(error)])
        assert result.information is not None
        planar = result.information[np.ix_((0, 1, 5), (0, 1, 5))]
        assert not np.delete(result.information, (0, 1, 5), axis=0).any()
        predicted.append(np.sqrt(np.diag(np.linalg.inv(planar))))
    ratio = np.std(errors, axis=0) / np.mean(predicted, axis=0)
    assert (ratio > 0.5).all() and (ratio < 2.0).all(), ratio


def test_a_bare_corridor_is_weak_along_its_axis() -> None:
    walls = outline((-50, -1), (50, -1), (50, 1), (-50, 1))[[0, 2]]
    scans = [
        Scan(k, 0.0, beam_points(cast(walls, se2(0.1 * k, 0.2, 0.6), AROUND), AROUND), True)
        for k in range(2)
    ]
    near = [Scan(s.index, 0.0, s.points[np.linalg.norm(s.points, axis=1) < 8], True) for s in scans]
    result = register(PolarScanMatching(0.5), near[1], near[0])
    assert result.information is not None
    held = result.information[:2, :2]
    values, vectors = np.linalg.eigh(held)
    assert values[0] < 0.02 * values[1]
    axis = np.array([np.cos(-0.6), np.sin(-0.6)])  # the corridor's, in the source's frame
    assert abs(vectors[:, 0] @ axis) > 0.99


def test_a_turned_world_gives_the_same_answer() -> None:
    """Bins follow the beams: both scans turned by 17.3 deg give the motion turned with them."""
    T = se2(0.1, 0.05, np.deg2rad(-8))
    start = se2(0.3, -0.2, 0.2)
    source, target = planar_scan(start @ T, 1, 0.005), planar_scan(start, 2, 0.005)
    turn = se2(0, 0, np.deg2rad(17.3))
    turned = [Scan(s.index, 0.0, transform(turn, s.points), True) for s in (source, target)]
    method = PolarScanMatching(0.5)
    plain = register(method, source, target).T_target_source
    other = register(method, *turned).T_target_source
    np.testing.assert_allclose(other, turn @ plain @ inverse(turn), atol=1e-6)
