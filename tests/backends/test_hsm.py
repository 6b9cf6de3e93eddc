"""Hough scan matching: any rotation without a guess, and what it does where that is ambiguous."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rbtm_bench.backends.base import Backend
from rbtm_bench.backends.hough_search import likeliest, likelihood, surfaces
from rbtm_bench.backends.hsm import HoughScanMatching
from rbtm_bench.backends.neighbours_2d import sorted_2d
from rbtm_bench.contract.scene import ANGLES, ROOM, cast, outline, planar_scan
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import inverse, rotation_angle, se2, transform, translation_norm, yaw
from rbtm_bench.core.types import Array, RegistrationResult, Scan
from rbtm_bench.datasets.base import beam_points
from rbtm_bench.datasets.environments import ENVIRONMENTS
from rbtm_bench.datasets.raycast import scan_walls
from rbtm_bench.odometry import judge

START = se2(0.5, -0.4, 0.3)
RECTANGLE = outline((-3, -2), (4, -2), (4, 2), (-3, 2))


@pytest.fixture(scope="module")
def hsm() -> HoughScanMatching:
    return HoughScanMatching(0.5)


def room_pair(T: Array, noise: float = 0.01, walls: Array = ROOM) -> tuple[Scan, Scan]:
    """Source and target with the motion T between them."""
    scans = []
    for index, pose in ((1, START @ T), (2, START)):
        ranges = cast(walls, pose, ANGLES)
        ranges += noise * np.random.default_rng(index).standard_normal(len(ranges))
        scans.append(Scan(index, 0.0, beam_points(ranges, ANGLES), True))
    return scans[0], scans[1]


def register(
    method: Backend, pair: tuple[Scan, Scan], guess: Array | None = None
) -> RegistrationResult:
    source, target = (method.prepare(scan) for scan in pair)
    return judge.register(method, source, target, np.eye(4) if guess is None else guess)


def off(result: RegistrationResult, truth: Array) -> tuple[float, float]:
    """m and deg from the truth."""
    error = inverse(truth) @ result.T_target_source
    return float(translation_norm(error)), float(np.degrees(rotation_angle(error)))


def is_found(result: RegistrationResult, truth: Array, metres: float, degrees: float) -> bool:
    m, deg = off(result, truth)
    return m <= metres and deg <= degrees


# ---- what it is for -----------------------------------------------------------------------------


@pytest.mark.parametrize("degrees", range(0, 360, 30))
def test_any_rotation_is_found_without_a_guess(hsm: HoughScanMatching, degrees: int) -> None:
    T = se2(0.8, -0.5, np.deg2rad(degrees))
    result = register(hsm, room_pair(T))
    assert result.converged
    assert is_found(result, T, 0.01, 0.2)


@pytest.mark.parametrize("degrees", [17.0, 133.0, -71.0])
def test_the_guess_does_not_matter(hsm: HoughScanMatching, degrees: float) -> None:
    T = se2(0.8, -0.5, np.deg2rad(degrees))
    pair = room_pair(T)
    expected = register(hsm, pair).T_target_source
    for guess in (T, se2(-50.0, 3.0, 2.0), se2(0.0, 900.0, -1.0)):
        np.testing.assert_array_equal(register(hsm, pair, guess).T_target_source, expected)


@pytest.mark.parametrize("degrees", [5, 40, 100, 215])
def test_the_cells_alone_are_off_by_less_than_they_are_wide(degrees: int) -> None:
    T = se2(0.8, -0.5, np.deg2rad(degrees))
    method = HoughScanMatching(0.5, refine_iterations=0)
    result = register(method, room_pair(T))
    assert result.converged
    assert result.iterations == 0
    assert is_found(result, T, 0.03, 1.0)


def test_scans_far_apart_are_found(hsm: HoughScanMatching) -> None:
    """The same room, 1 km from the target's own origin."""
    T, away = se2(0.5, 0.2, np.deg2rad(150)), se2(800.0, -600.0, 1.0)
    source, target = room_pair(T)
    moved = Scan(9, 0.0, transform(away, target.points), True)
    result = register(hsm, (source, moved))
    assert result.converged
    assert is_found(result, away @ T, 0.01, 0.2)


def test_half_the_field_of_view_is_enough(hsm: HoughScanMatching) -> None:
    """180 deg scans, turned by 40 deg: three quarters of the source are in the target."""
    forward = np.deg2rad(np.linspace(-90, 90, 361))
    for k, along in enumerate((0.5, 2.0, 3.5, 5.0)):
        start, T = se2(along, 0.0, 0.0), se2(0.1, -0.2, np.deg2rad((-1) ** k * 40))
        poses = np.stack([start @ T, start])
        ranges = scan_walls(ENVIRONMENTS["cluttered"].walls, poses, forward, 30.0)
        ranges = ranges + 0.01 * np.random.default_rng(k).standard_normal(ranges.shape)
        source, target = (
            Scan(i, 0.0, beam_points(one, forward), True) for i, one in enumerate(ranges)
        )
        result = register(hsm, (source, target))
        assert is_found(result, T, 0.03, 0.5)
        assert result.converged


def test_merged_scans_are_a_target(hsm: HoughScanMatching) -> None:
    places = [se2(0.3 * k, 0.1 * k, 0.4 * k) for k in range(4)]
    parts = [(hsm.prepare(planar_scan(START @ T, k, 0.01)), T) for k, T in enumerate(places)]
    T = se2(0.5, 0.3, np.deg2rad(-140))
    source = hsm.prepare(planar_scan(START @ T, 9, 0.01))
    result = judge.register(hsm, source, hsm.merge(parts), np.eye(4))
    assert is_found(result, T, 0.01, 0.3)


@pytest.mark.parametrize("votes", ["surface", "points"])
def test_points_may_vote_by_length_of_surface_or_one_each(votes: Any) -> None:
    T = se2(0.8, -0.5, np.deg2rad(100))
    method = HoughScanMatching(0.5, votes=votes)
    source, target = room_pair(T)
    weights = method.prepare(target).native.weights
    assert weights.sum() == pytest.approx(1.0)
    assert (np.ptp(weights) > 1e-3) == (votes == "surface")
    assert is_found(register(method, (source, target)), T, 0.01, 0.2)


# ---- ambiguity, limits, failure -----------------------------------------------------------------


def test_in_a_rectangle_the_answer_nearest_to_the_guess_is_taken(hsm: HoughScanMatching) -> None:
    """Turned by 180 deg about its middle the rectangle is the same: both poses fit."""
    T = se2(0.4, -0.3, np.deg2rad(25))
    pair = room_pair(T, walls=RECTANGLE)
    middle = inverse(START) @ se2(1.0, 0.0, 0.0)  # (0.5, 0) turned by 180 deg about it
    other = middle @ se2(0.0, 0.0, np.pi) @ START @ T
    for truth in (T, other):
        for error in (se2(0.0, 0.0, 0.0), se2(0.5, -0.5, 1.0)):
            result = register(hsm, pair, truth @ error)
            assert is_found(result, truth, 0.015, 0.3)
            assert result.converged


def test_without_ambiguity_the_likelier_one_wins() -> None:
    """A box in a corner of the rectangle tells, whatever the guess."""
    box = outline((-2.9, -1.9), (-1.9, -1.9), (-1.9, -0.9), (-2.9, -0.9))
    T = se2(0.4, -0.3, np.deg2rad(25))
    pair = room_pair(T, walls=np.concatenate([RECTANGLE, box]))
    turned = inverse(START) @ se2(1.0, 0.0, np.pi) @ START @ T
    assert is_found(register(HoughScanMatching(0.5), pair, turned), T, 0.015, 0.3)
    lenient = HoughScanMatching(0.5, ambiguity=0.5)
    assert is_found(register(lenient, pair, turned), turned, 0.05, 1.0)


def test_a_limited_search_stays_near_the_guess() -> None:
    T = se2(0.8, -0.5, np.deg2rad(150))
    pair = room_pair(T)
    near = HoughScanMatching(0.5, max_rotation_deg=30.0, max_translation=0.6)
    assert near.uses_guess and not HoughScanMatching(0.5).uses_guess
    assert is_found(register(near, pair, T @ se2(0.3, 0.2, np.deg2rad(-20))), T, 0.01, 0.2)
    for guess in (se2(0.8, -0.5, 0.0), T @ se2(0.0, 3.0, 0.0)):
        result = register(near, pair, guess)
        assert not is_found(result, T, 0.3, 10.0)
        moved = inverse(guess) @ result.T_target_source
        assert abs(np.degrees(yaw(moved))) < 31.0
        assert translation_norm(moved) < 0.61


def test_another_place_is_not_converged(hsm: HoughScanMatching) -> None:
    """Scans of a room against scans of three other places."""
    room = planar_scan(START, 1, 0.01)
    for place in ("paper", "cluttered", "l_turn"):
        pose = ENVIRONMENTS[place].poses(np.array([1.0]))
        ranges = scan_walls(ENVIRONMENTS[place].walls, pose, ANGLES, 30.0)[0]
        other = Scan(2, 0.0, beam_points(ranges, ANGLES), True)
        result = register(hsm, (room, other))
        assert result.converged is False, f"{place}: {result.library_fitness}"


def test_points_beyond_max_norm_do_not_vote() -> None:
    source, target = room_pair(se2(0.2, 0.1, 0.5))
    method = HoughScanMatching(0.5, max_norm=3.0)
    native = method.prepare(target).native
    assert native.reach <= 3.0
    assert len(native.weights) < len(target.points) == len(native.points.xy)
    with pytest.raises(BackendError, match="max_norm"):
        HoughScanMatching(0.5, max_norm=0.01).prepare(target)
    assert is_found(register(method, (source, target)), se2(0.2, 0.1, 0.5), 0.01, 0.3)


def test_clouds_in_space_are_refused(hsm: HoughScanMatching) -> None:
    points = np.random.default_rng(0).standard_normal((100, 3))
    with pytest.raises(BackendError, match="planar"):
        hsm.prepare(Scan(0, 0.0, points, False))


# ---- likelihood, surfaces, uncertainty ----------------------------------------------------------


def test_the_likelihood_by_hand() -> None:
    """Distances of 0, 0.05, 0.1 and 3 m within 0.1 m: 1, 0.75, 0 and 0."""
    target = sorted_2d(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]))
    xy = np.array([[0.0, 0.0], [1.0, 0.05], [2.0, 0.1], [2.0, 3.0]])
    assert likelihood(target, xy, (0.0, 0.0, 0.0), 0.1, 1) == pytest.approx(1.75 / 4)
    assert likelihood(target, xy, (0.0, 0.0, 0.0), 0.1, 2) == pytest.approx(0.5)  # every other
    turned = xy @ np.array([[0.0, -1.0], [1.0, 0.0]]) - [5.0, 1.0]
    back = (1.0, -5.0, 0.5 * np.pi)  # p -> R p + t undoes it: R (-5, -1) = (1, -5)
    assert likelihood(target, turned, (-back[0], -back[1], back[2]), 0.1, 1) == pytest.approx(
        1.75 / 4
    )


def test_the_likeliest_are_different_and_in_order() -> None:
    target = sorted_2d(np.column_stack([np.linspace(0, 3, 31), np.zeros(31)]))
    xy = np.column_stack([np.linspace(0, 3, 31), np.zeros(31)])
    poses = np.array([[0.0, 0.09, 0.0], [0.0, 0.02, 0.0], [0.0, 0.01, 0.001], [1.5, 0.0, 0.0]])
    best = likeliest(poses, target, xy, 0.2, 1, 3)
    assert best[:, 1].tolist() == [0.01, 0.0]  # the first two are the third one's neighbours
    assert len(likeliest(poses, target, xy, 0.2, 1, 1)) == 1


def test_surfaces_have_normals_where_there_are_neighbours() -> None:
    wall = np.column_stack([np.linspace(0, 1, 21), 0.5 * np.linspace(0, 1, 21)])
    points = sorted_2d(np.concatenate([wall, [[9.0, 9.0]]]))
    normals, density = surfaces(points, 0.2)
    lonely = int(np.argmax(points.xy[:, 0]))
    assert normals[lonely].tolist() == [0.0, 0.0]
    assert density[lonely] == 1
    on_wall = np.delete(normals, lonely, axis=0)
    across = np.array([-0.5, 1.0]) / np.hypot(0.5, 1.0)
    np.testing.assert_allclose(np.abs(on_wall @ across), 1.0)
    assert density.max() == 7  # 0.056 m apart: three to each side


def test_the_information_is_that_of_the_errors(hsm: HoughScanMatching) -> None:
    """Over 30 noisy pairs the errors spread as predicted, within a factor of 2."""
    T = se2(0.1, -0.05, 2.0)
    errors, predicted = [], []
    for k in range(30):
        source, target = planar_scan(START @ T, 2 * k, 0.01), planar_scan(START, 2 * k + 1, 0.01)
        result = register(hsm, (source, target))
        error = inverse(T) @ result.T_target_source
        errors.append([error[0, 3], error[1, 3], yaw(error)])
        assert result.information is not None
        planar = result.information[np.ix_((0, 1, 5), (0, 1, 5))]
        predicted.append(np.sqrt(np.diag(np.linalg.inv(planar))))
    ratio = np.std(errors, axis=0) / np.mean(predicted, axis=0)
    assert (ratio > 0.5).all() and (ratio < 2.0).all(), ratio
