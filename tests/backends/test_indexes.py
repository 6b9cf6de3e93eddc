"""Where the judge finds the nearest points, in the plane and in space, against looking at all."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rbtm_bench.backends.plane_index import MOST_IN_A_BUCKET, nearest, plane_index
from rbtm_bench.backends.space_index import nearest_in_space, neighbours_in_space, space_index
from rbtm_bench.core.types import Array

COORDINATE = st.floats(-20.0, 20.0, width=32)
MANY_IN_ONE_PLACE = np.concatenate([np.full((2 * MOST_IN_A_BUCKET, 2), 0.25), [[900.0, 3.0]]])


def clouds(columns: int) -> st.SearchStrategy[Array]:
    return st.integers(1, 40).flatmap(
        lambda count: arrays(np.float64, (count, columns), elements=COORDINATE)
    )


def in_the_plane(cloud: Array, point: Array, radius: float) -> float:
    """The distance to the nearest point, inf beyond the radius."""
    index = plane_index(cloud)
    u, v = point[::-1] if index.frame[2] else point
    along, across = index.points
    place, square = nearest(along, across, index.start, index.frame, u, v, radius**2, -1)
    return float(np.sqrt(square)) if place >= 0 else np.inf


@settings(max_examples=80, deadline=None)
@given(clouds(2), st.tuples(COORDINATE, COORDINATE), st.floats(0.01, 60.0))
def test_the_nearest_in_the_plane_is_the_nearest_of_all(cloud, point, radius) -> None:
    squares = ((cloud - point) ** 2).sum(axis=1)
    expected = np.sqrt(squares.min()) if squares.min() < radius**2 else np.inf
    assert in_the_plane(cloud, np.array(point), radius) == pytest.approx(expected, rel=1e-12)


def test_points_in_one_place_are_sorted_all_the_same() -> None:
    assert in_the_plane(MANY_IN_ONE_PLACE, np.array([901.0, 3.0]), 2.0) == 1.0
    assert in_the_plane(MANY_IN_ONE_PLACE, np.array([0.25, 1.25]), 2.0) == 1.0
    index = plane_index(MANY_IN_ONE_PLACE)
    assert (np.diff(index.points[0]) >= 0).all() and index.start[-1] == len(MANY_IN_ONE_PLACE)


def test_what_is_known_already_stays_where_nothing_is_nearer() -> None:
    index = plane_index(np.array([[0.0, 0.0], [8.0, 0.0]]))
    along, across = index.points
    assert nearest(along, across, index.start, index.frame, 1.0, 0.0, 0.25, 1) == (1, 0.25)
    assert nearest(along, across, index.start, index.frame, 0.5, 0.0, 0.25, -1) == (-1, 0.25)


@settings(max_examples=80, deadline=None)
@given(clouds(3), st.tuples(COORDINATE, COORDINATE, COORDINATE), st.floats(0.01, 60.0))
def test_the_nearest_in_space_is_the_nearest_of_all(cloud, point, radius) -> None:
    index = space_index(cloud, radius)
    place, square = nearest_in_space(index, *point, radius**2)
    squares = ((cloud - point) ** 2).sum(axis=1)
    if squares.min() < radius**2:
        assert square == pytest.approx(squares.min(), rel=1e-12)
        assert ((index.points[place] - point) ** 2).sum() == pytest.approx(square, rel=1e-12)
    else:
        assert (place, square) == (-1, radius**2)


@settings(max_examples=60, deadline=None)
@given(clouds(3), st.floats(0.5, 30.0), st.integers(1, 12))
def test_neighbours_in_space_are_the_nearest_within_the_radius(cloud, radius, most) -> None:
    index = space_index(cloud, radius)
    places, squares = np.empty(most, np.int64), np.empty(most)
    count = neighbours_in_space(index, 0, places, squares)
    every = np.sort(((index.points - index.points[0]) ** 2).sum(axis=1))
    expected = every[every < radius**2][:most]
    np.testing.assert_allclose(squares[:count], expected, rtol=1e-12)
    assert len(set(places[:count].tolist())) == count


def test_a_point_on_the_border_of_a_cell_is_found() -> None:
    """Cells of 0.3 m: 0.6 / 0.3 and 0.9 / 0.3 are not what they are on paper."""
    for x in np.arange(-30, 30) * 0.3:
        cloud = np.array([[x, 0.0, 0.0], [x + 50.0, 0.0, 0.0]])
        for offset in (-0.2999, 0.2999, -1e-12, 1e-12, 0.0):
            place, square = nearest_in_space(space_index(cloud, 0.3), x + offset, 0, 0, 0.09)
            assert place >= 0 and square == pytest.approx(offset**2, abs=1e-9)


def test_far_from_the_origin_cells_are_still_numbers() -> None:
    cloud = np.array([[1e12, 0.0, 0.0], [0.0, 0.0, 0.0]])
    place, _ = nearest_in_space(space_index(cloud, 0.3), 0.1, 0.0, 0.0, 0.09)
    assert place >= 0
