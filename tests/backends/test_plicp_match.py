"""Segments of an unordered scan, and trimming, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.backends.plicp_match import (
    BAND,
    Surface,
    axis_of_sorting,
    remove_doubles,
    shortened,
    surface_of,
    trim,
)
from rbtm_bench.backends.plicp_step import Matches
from rbtm_bench.core.types import Array


def flat(xy: Array) -> Array:
    """Points (N, 3) in z = 0."""
    return np.column_stack([xy, np.zeros(len(xy))])


def neighbours(surface: Surface, points: Array) -> dict[int, set[int]]:
    """The numbers of each point's neighbours in ``points``."""
    number = surface.points.original
    return {
        int(number[j]): {int(number[k]) for k in surface.sides[j] if k >= 0}
        for j in range(len(points))
    }


def matches_at(distance: list[float], first: list[int] | None = None) -> Matches:
    count = len(distance)
    places = np.arange(count) if first is None else np.array(first)
    return Matches(np.arange(count), places, places + 1, np.array(distance))


def test_a_wall_in_any_order_is_a_chain() -> None:
    order = np.random.default_rng(0).permutation(20)
    wall = flat(np.stack([0.2 * order, 1.0 + 0.1 * order], axis=1))
    sides = neighbours(surface_of(wall, 0.0), wall)
    place = {int(number): i for i, number in enumerate(order)}
    for number in range(1, 19):
        assert sides[place[number]] == {place[number - 1], place[number + 1]}
    assert sides[place[0]] == {place[1]}, "an end has one side"


def test_a_corner_belongs_to_both_walls() -> None:
    leg = np.linspace(0.2, 2, 10)
    corner = np.concatenate([[[0, 0]], np.stack([leg, 0 * leg], 1), np.stack([0 * leg, leg], 1)])
    sides = neighbours(surface_of(flat(corner), 0.0), corner)
    assert sides[0] == {1, 11}
    assert sides[1] == {0, 2} and sides[11] == {0, 12}


def test_segments_are_as_long_as_asked() -> None:
    wall = flat(np.stack([0.03 * np.arange(40), np.zeros(40)], axis=1))
    surface = surface_of(wall, 0.1)
    xy = surface.points.xy
    for j, sides in enumerate(surface.sides):
        lengths = [np.linalg.norm(xy[k] - xy[j]) for k in sides if k >= 0]
        np.testing.assert_allclose(lengths, 0.12, atol=1e-12)  # the first beyond 0.1 m
    assert neighbours(surface, wall)[20] == {16, 24}


def test_no_segment_crosses_a_gap() -> None:
    gap = np.concatenate([np.arange(5) * 0.1, 2.0 + np.arange(5) * 0.1])
    points = flat(np.stack([gap, np.zeros(10)], axis=1))
    sides = neighbours(surface_of(points, 0.0), points)
    assert sides[4] == {3} and sides[5] == {6}


def test_points_at_one_place_have_no_segment_between_them() -> None:
    twice = flat(np.repeat(np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0]]), 2, axis=0))
    surface = surface_of(twice, 0.0)
    for j, sides in enumerate(surface.sides):
        apart = [np.linalg.norm(surface.points.xy[k] - surface.points.xy[j]) for k in sides]
        assert apart[0] == pytest.approx(0.5)
    alone = surface_of(flat(np.zeros((6, 2))), 0.0)
    assert (alone.sides == -1).all()


@pytest.mark.parametrize("degrees", [0.0, 90.0, 30.0])
def test_walls_do_not_lie_across_the_axis_of_sorting(degrees: float) -> None:
    """A corridor along any direction: few points within a band of the sorted axis."""
    along = np.linspace(-4, 4, 200)
    walls = np.concatenate([np.stack([along, along * 0 + y], axis=1) for y in (-1.0, 1.0)])
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    points = flat(walls @ np.array([[c, s], [-s, c]]))
    turn = axis_of_sorting(points)
    x = np.cos(turn) * points[:, 0] - np.sin(turn) * points[:, 1]
    most = max(((x >= low) & (x < low + BAND)).sum() for low in np.arange(-5, 5, BAND))
    assert most <= 16  # at best 2 x BAND / 0.04 m = 5; all 200 of a wall at the worst


def test_the_turned_points_are_the_points() -> None:
    points = flat(np.random.default_rng(1).uniform(-3, 3, (50, 2)))
    surface = surface_of(points, 0.1)
    c, s = np.cos(surface.turn), np.sin(surface.turn)
    back = surface.points.xy @ np.array([[c, -s], [s, c]])
    np.testing.assert_allclose(back, points[surface.points.original, :2], atol=1e-12)
    assert (np.diff(surface.points.xy[:, 0]) >= 0).all()


def test_the_percentile_cuts_the_worst() -> None:
    matches = matches_at([5.0, 1.0, 4.0, 2.0, 3.0, 10.0, 9.0, 8.0, 7.0, 6.0])
    kept, mean_square = trim(matches, 10, 0.6, 0.7, 100.0, 0.0)
    # floor(10 x 0.6) = 6: no farther than the one after the first six in order
    assert sorted(matches.distance[:kept]) == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
    assert mean_square == pytest.approx((1 + 4 + 9 + 16 + 25 + 36 + 49) / 7)
    assert list(matches.source[:kept]) == [0, 1, 2, 3, 4, 8, 9], "matches keep their points"


def test_the_adaptive_limit_follows_the_order() -> None:
    matches = matches_at([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.5, 1.9, 2.1, 50.0])
    kept, _ = trim(matches, 11, 1.0, 0.5, 2.0, 0.0)
    assert list(matches.distance[:kept]) == [1.0] * 7 + [1.5, 1.9]


def test_nothing_nearer_than_the_floor_is_cut() -> None:
    """Seven points on walls that fit exactly make both limits 0; the three of a recess, one step
    of 10 mm along the corridor away, are what tells the step."""
    distance = [0.0] * 7 + [0.010, 0.010, 0.031]
    assert trim(matches_at(distance), 10, 0.9, 0.6, 2.0, 0.0)[0] == 7
    matches = matches_at(distance)
    kept, mean_square = trim(matches, 10, 0.9, 0.6, 2.0, 0.03)
    assert list(matches.distance[:kept]) == [0.0] * 7 + [0.010, 0.010]
    assert mean_square == pytest.approx(2e-4 / 9)
    far = [0.05] * 9 + [0.09]  # limits above the floor are what they were: the ninth of ten
    assert trim(matches_at(far), 10, 0.9, 0.7, 2.0, 0.03)[0] == 10
    assert trim(matches_at(far), 10, 0.8, 0.7, 2.0, 0.03)[0] == 9


def test_perfect_matches_are_all_kept() -> None:
    kept, mean_square = trim(matches_at([0.0] * 8), 8, 0.9, 0.7, 2.0, 0.0)
    assert (kept, mean_square) == (8, 0.0)
    assert trim(matches_at([]), 0, 0.9, 0.7, 2.0, 0.0) == (0, 0.0)


def test_of_doubles_the_nearest_is_kept() -> None:
    moved = np.array([[0.0, 0.3], [0.0, 0.1], [0.0, 0.2], [1.0, 0.5]])
    target = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    matches = matches_at([0.3, 0.1, 0.2, 0.5], first=[0, 0, 0, 1])
    kept = shortened(matches, remove_doubles(moved, target, matches, 4))
    assert list(kept.source) == [1, 3] and list(kept.first) == [0, 1]
    assert list(kept.distance) == [0.1, 0.5]
