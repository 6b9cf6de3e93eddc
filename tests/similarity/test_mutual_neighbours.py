"""Mutual nearest neighbours under a guess: by hand, and against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from rbtm_bench.contract.scene import cloud, planar_scan
from rbtm_bench.core.geometry import inverse, se2, transform
from rbtm_bench.core.types import Array
from rbtm_bench.similarity.mutual_neighbours import MutualNeighbours
from rbtm_bench.similarity.overlap import Overlap
from rbtm_bench.similarity.points import descriptor_of, points_of

STILL = np.eye(4)


def at(*xy: tuple[float, float], most: int = 8) -> Array:
    """The descriptor of points in the plane."""
    points = np.array(xy, dtype=float).reshape(-1, 2)
    return descriptor_of(np.column_stack([points, np.zeros(len(points))]), most)


def one(
    similarity: MutualNeighbours | Overlap, model: Array, scan: Array, T_model_scan: Array = STILL
) -> float:
    return float(similarity.scores_under(model[None], scan, T_model_scan[None])[0])


def test_by_hand() -> None:
    """(0, 0) and (1, 0) have partners; (1.2, 0) is near (1, 0), which has a nearer one; (5, 5) is
    near nothing: 2 pairs, so 4 of 2 + 4 points."""
    similarity = MutualNeighbours(0.5, min_points=1)
    model, scan = at((0, 0), (1, 0)), at((0, 0.1), (1.1, 0), (1.2, 0), (5, 5))
    assert one(similarity, model, scan) == pytest.approx(4 / 6, abs=1e-15)
    assert one(similarity, scan, model) == pytest.approx(4 / 6, abs=1e-15)
    assert one(Overlap(0.5, min_points=1), model, scan) == pytest.approx((3 / 4 + 1) / 2)


def test_a_dense_wall_against_a_thin_one() -> None:
    """Every second point of 8 has a partner: 4 pairs of 12 points, where overlap says 1."""
    dense = at(*((0.1 * i, 0) for i in range(8)))
    thin = at(*((0.2 * i, 0.01) for i in range(4)))
    assert one(MutualNeighbours(0.5, min_points=1), dense, thin) == pytest.approx(8 / 12)
    assert one(Overlap(0.5, min_points=1), dense, thin) == 1.0


@pytest.mark.parametrize(("radius", "score"), [(0.25, 0.0), (0.2500001, 1.0)])
def test_partners_are_nearer_than_the_radius(radius, score) -> None:
    assert one(MutualNeighbours(radius, min_points=1), at((0, 0)), at((0, 0.25))) == score


def test_points_that_coincide_are_everybodys_partner() -> None:
    double = at((0, 0), (0, 0), (1, 0))
    similarity = MutualNeighbours(0.5, min_points=1)
    assert one(similarity, double, double) == 1.0
    assert one(similarity, double, at((0, 0), (1, 0))) == 1.0


def test_the_guess_moves_the_new_scan() -> None:
    similarity = MutualNeighbours(0.01, min_points=1)
    T = se2(5.0, 0.0, np.pi / 2)
    model = at((1, 0), (2, 0), (2, 3), (5, 1))
    scan = descriptor_of(transform(inverse(T), points_of(model)[0].astype(float)), 8)
    assert one(similarity, model, scan, T) == 1.0
    assert one(similarity, model, scan, inverse(T)) == 0.0


def test_too_few_points_or_no_motion_are_undefined() -> None:
    model, lost = at((0, 0), (1, 0)), np.full((4, 4), np.nan)
    assert np.isnan(one(MutualNeighbours(min_points=3), model, model))
    assert np.isnan(one(MutualNeighbours(min_points=1), model, at()))
    assert np.isnan(one(MutualNeighbours(min_points=1), model, model, lost))
    assert one(MutualNeighbours(min_points=2), model, model) == 1.0


def by_brute_force(model: Array, scan: Array, T: Array, radius: float) -> float:
    p, q = points_of(model)[0].astype(float), points_of(scan)[0].astype(float)
    distance = cdist(p, transform(T, q))
    to_q, to_p = distance.argmin(axis=1), distance.argmin(axis=0)
    places = np.arange(len(p))
    pairs = (to_p[to_q] == places) & (distance[places, to_q] < radius)
    return float(2 * pairs.sum() / (len(p) + len(q)))


@settings(deadline=None, max_examples=60)
@given(
    planar=st.booleans(),
    x=st.floats(-0.8, 0.8),
    y=st.floats(-0.5, 0.5),
    turn=st.floats(-3.2, 3.2),
    radius=st.floats(0.02, 1.0),
    seed=st.integers(0, 1000),
)
def test_two_simulated_scans_against_brute_force(planar, x, y, turn, radius, seed) -> None:
    """Noise sees to it that no two distances are equal."""
    similarity = MutualNeighbours(radius, points=300)
    seen = planar_scan if planar else cloud
    model = similarity.describe(seen(STILL, seed, 0.01))
    scan = similarity.describe(seen(se2(x, y, turn), seed + 1, 0.01))
    for guess in (se2(x, y, turn), se2(x + 0.2, y, turn - 0.3)):
        expected = by_brute_force(model, scan, guess, radius)
        assert one(similarity, model, scan, guess) == pytest.approx(expected, abs=1e-12)
        assert one(similarity, scan, model, inverse(guess)) == pytest.approx(expected, abs=1e-12)
        assert expected <= by_overlap(model, scan, guess, radius)


def by_overlap(model: Array, scan: Array, T: Array, radius: float) -> float:
    """The share of all points with a neighbour: no fewer can have a mutual one."""
    p, q = points_of(model)[0].astype(float), points_of(scan)[0].astype(float)
    near = cdist(p, transform(T, q)) < radius
    return float((near.any(axis=0).sum() + near.any(axis=1).sum()) / (len(p) + len(q)))
