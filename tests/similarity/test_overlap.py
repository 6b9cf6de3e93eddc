"""Overlap under a guess: by hand, and against brute force on simulated scans."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from rbtm_bench.contract.scene import cloud, planar_scan
from rbtm_bench.core.geometry import inverse, se2, transform
from rbtm_bench.core.types import Array
from rbtm_bench.similarity.overlap import Overlap
from rbtm_bench.similarity.points import descriptor_of, points_of

STILL = np.eye(4)


def at(*xy: tuple[float, float], most: int = 8) -> Array:
    """The descriptor of points in the plane."""
    points = np.array(xy, dtype=float).reshape(-1, 2)
    return descriptor_of(np.column_stack([points, np.zeros(len(points))]), most)


def one(similarity: Overlap, model: Array, scan: Array, T_model_scan: Array = STILL) -> float:
    return float(similarity.scores_under(model[None], scan, T_model_scan[None])[0])


MODEL = at((0, 0), (1, 0), (2, 0), (3, 0))
SCAN = at((0, 0.25), (1, 0.25), (9, 9))


@pytest.mark.parametrize(
    ("directions", "expected"), [("mean", (2 / 3 + 2 / 4) / 2), ("minimum", 0.5)]
)
def test_by_hand(directions, expected) -> None:
    """2 of the scan's 3 points have a neighbour, and 2 of the model's 4."""
    similarity = Overlap(0.3, directions, min_points=1)
    assert one(similarity, MODEL, SCAN) == pytest.approx(expected, abs=1e-15)
    assert one(similarity, SCAN, MODEL) == one(similarity, MODEL, SCAN)
    assert similarity.scores(MODEL[None], SCAN)[0] == one(similarity, MODEL, SCAN)


def test_the_guess_moves_the_new_scan() -> None:
    """A quarter turn about the model's origin and 5 m forward brings the scan onto the model; the
    same motion the other way round does not."""
    similarity = Overlap(0.01, min_points=1)
    T = se2(5.0, 0.0, np.pi / 2)
    model = at((1, 0), (2, 0), (2, 3), (5, 1))
    points, _ = points_of(model)
    scan = descriptor_of(transform(inverse(T), points.astype(float)), 8)
    assert one(similarity, model, scan, T) == 1.0
    assert one(similarity, model, scan, inverse(T)) == 0.0
    assert one(similarity, scan, model, inverse(T)) == 1.0


@pytest.mark.parametrize(("radius", "near"), [(0.25, False), (0.2500001, True)])
def test_a_neighbour_is_nearer_than_the_radius(radius, near) -> None:
    assert one(Overlap(radius, min_points=1), at((0, 0)), at((0, 0.25))) == float(near)


def test_points_of_the_other_wall_are_not_near() -> None:
    """Sorted along x they are neighbours; in the plane they are 2 m apart."""
    left = at((0, 1), (0.1, 1), (0.2, 1), (0.3, 1))
    right = at((0, -1), (0.1, -1), (0.2, -1), (0.3, -1))
    assert one(Overlap(0.3, min_points=1), left, right) == 0.0
    assert one(Overlap(2.01, min_points=1), left, right) == 1.0


def test_too_few_points_are_undefined() -> None:
    similarity = Overlap(0.3, min_points=4)
    assert np.isnan(one(similarity, MODEL, SCAN)) and np.isnan(one(similarity, SCAN, MODEL))
    assert one(similarity, MODEL, MODEL) == 1.0
    assert np.isnan(one(Overlap(min_points=1), at(), at()))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_motion_that_is_not_finite_is_undefined(value) -> None:
    T = STILL.copy()
    T[0, 3] = value
    motions = np.stack([STILL, T])
    scores = Overlap(min_points=1).scores_under(np.stack([MODEL, MODEL]), MODEL, motions)
    np.testing.assert_array_equal(scores, [1.0, np.nan])


def by_brute_force(model: Array, scan: Array, T: Array, radius: float) -> tuple[float, bool]:
    """The mean share, and whether any distance is the radius to within rounding."""
    p, q = points_of(model)[0].astype(float), points_of(scan)[0].astype(float)
    distance = cdist(p, transform(T, q))
    near = distance < radius
    share = (near.any(axis=0).mean() + near.any(axis=1).mean()) / 2
    return float(share), bool((np.abs(distance - radius) < 1e-9).any())


@settings(deadline=None, max_examples=60)
@given(
    planar=st.booleans(),
    x=st.floats(-0.8, 0.8),
    y=st.floats(-0.5, 0.5),
    turn=st.floats(-3.2, 3.2),
    off=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    radius=st.floats(0.02, 1.0),
    seed=st.integers(0, 1000),
)
def test_two_simulated_scans_against_brute_force(planar, x, y, turn, off, radius, seed) -> None:
    """In a room and in space, under the true motion and a wrong one, turned by any angle."""
    similarity = Overlap(radius, points=300)
    seen = planar_scan if planar else cloud
    T = se2(x, y, turn)
    model = similarity.describe(seen(STILL, seed, 0.01))
    scan = similarity.describe(seen(T, seed + 1, 0.01))
    for guess in (T, T @ se2(*off)):
        expected, tie = by_brute_force(model, scan, guess, radius)
        assume(not tie)
        assert one(similarity, model, scan, guess) == pytest.approx(expected, abs=1e-12)
        assert one(similarity, scan, model, inverse(guess)) == pytest.approx(expected, abs=1e-12)


def test_under_the_true_motion_overlap_falls_with_what_is_seen_anew() -> None:
    """Half-way round a corner less of the room is seen from both places."""
    similarity = Overlap(0.1)
    start = similarity.describe(planar_scan(se2(-2, -1, 0)))
    moves = [se2(-2 + x, -1 + y, 0) for x, y in ((0.1, 0), (1, 0.3), (3, 1), (5, 2.2))]
    scores = [
        one(similarity, start, similarity.describe(planar_scan(T)), inverse(se2(-2, -1, 0)) @ T)
        for T in moves
    ]
    assert scores == sorted(scores, reverse=True)
    assert scores[0] > 0.95 and scores[-1] < 0.9
