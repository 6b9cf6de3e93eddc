"""How sure a motion between keyframes is: against the path alone, by hand, and by sampling."""

from __future__ import annotations

import numpy as np
import pytest
from test_track import route_of

from rbtm_bench.core.geometry import inverse, se2
from rbtm_bench.core.types import Array
from rbtm_bench.core.uncertainty import (
    ODOMETRY_M,
    ODOMETRY_RAD,
    ODOMETRY_SHARE,
    odometry_covariance,
)
from rbtm_bench.graph.motions import moved, small
from rbtm_bench.graph.optimise import optimise
from rbtm_bench.loops.certainty import Certainty
from rbtm_bench.loops.track import Track
from rbtm_bench.loops.verify import Limits, Loop, Pair, Verifier

PLANE = [0, 1, 5]
SURE = np.diag([0.01, 0.01, 0.0, 0.0, 0.0, 0.005]) ** 2


@pytest.fixture
def track() -> Track:
    """Nine keyframes of a chain, 1 m apart."""
    return Track(route_of([(i, i + 1) for i in range(8)]), True, 0.5, 90.0)


def loop_of(track: Track, model: int, scan: int) -> Loop:
    T = inverse(track.T_world_scan[model]) @ track.T_world_scan[scan]
    return Loop(Pair(model, scan), T, SURE)


def test_without_loops_it_is_the_path(track) -> None:
    pairs = [Pair(0, 3), Pair(2, 8)]
    for pair, covariance in zip(
        pairs, Certainty(track, track.T_world_scan, ()).between(pairs), strict=True
    ):
        np.testing.assert_array_equal(covariance, track.between(*pair)[1])


def test_a_loop_makes_what_it_spans_sure(track) -> None:
    """Nothing is known better than before but what lies on the loop or is reached over it."""
    certainty = Certainty(track, track.T_world_scan, [loop_of(track, 1, 6)])
    pairs = [Pair(1, 6), Pair(0, 8), Pair(6, 8), Pair(3, 4)]
    closed, beyond, after, within = certainty.between(pairs)
    before = [track.between(*pair)[1] for pair in pairs]
    two_ways = np.linalg.inv(
        np.linalg.inv(SURE[np.ix_(PLANE, PLANE)]) + np.linalg.inv(before[0][np.ix_(PLANE, PLANE)])
    )
    np.testing.assert_allclose(closed[np.ix_(PLANE, PLANE)], two_ways, rtol=1e-9, atol=1e-12)
    assert np.trace(beyond) < np.trace(before[1])
    np.testing.assert_allclose(after, before[2], atol=1e-12)
    assert np.trace(within) < np.trace(before[3])


def test_it_is_how_far_optima_scatter(track) -> None:
    """The graph of keyframes, solved for 400 draws of all its edges."""
    rng, pair = np.random.default_rng(5), Pair(2, 7)
    certainty = Certainty(track, track.T_world_scan, [loop_of(track, 1, 6)])
    (expected,) = certainty.between([pair])
    graph = certainty.graph()
    covariances = np.zeros_like(graph.information)
    free = np.ix_(range(len(graph.ends)), PLANE, PLANE)
    covariances[free] = np.linalg.inv(graph.information[free]) * 1e-4  # small: to first order
    offs = []
    for _ in range(400):
        noise = np.stack([rng.multivariate_normal(np.zeros(6), each) for each in covariances])
        drawn = type(graph)(
            graph.scans, graph.T_world_scan, graph.ends, moved(graph.T_model_scan, noise),
            graph.information, graph.may_be_wrong, True,
        )  # fmt: skip
        T = optimise(drawn, None).graph.T_world_scan
        exact = inverse(track.T_world_scan[pair.model]) @ track.T_world_scan[pair.scan]
        offs.append(inverse(exact) @ inverse(T[pair.model]) @ T[pair.scan])
    scatter = np.cov(small(np.stack(offs))[:, PLANE].T) / 1e-4
    np.testing.assert_allclose(
        np.sqrt(np.diag(scatter)), np.sqrt(np.diag(expected)[PLANE]), rtol=0.15
    )


def test_a_search_must_reach_what_may_be() -> None:
    """Three sigmas of 1.2 m are within 4 m, of 1.5 m not; nor are three of 10 deg within 25."""

    def unsure(metres: float, degrees: float) -> Array:
        return np.diag([metres, 0.1, 0.0, 0.0, 0.0, np.radians(degrees)]) ** 2

    track = Track(route_of([(0, 1), (1, 2)]), True, 0.5, 90.0)
    verifier = Verifier(Limits(search_m=4.0, search_deg=25.0), track, None, None)  # type: ignore[arg-type]
    assert verifier.reaches(unsure(1.2, 5.0))
    assert not verifier.reaches(unsure(1.5, 5.0))
    assert not verifier.reaches(unsure(1.2, 10.0))


def test_odometry_by_hand() -> None:
    """1 cm and a tenth of 2 m; 0.005 rad and a tenth of 0.5 rad."""
    m, rad = ODOMETRY_M + 2 * ODOMETRY_SHARE, ODOMETRY_RAD + 0.5 * ODOMETRY_SHARE
    covariance = odometry_covariance(se2(2.0, 0.0, -0.5), True)
    np.testing.assert_allclose(covariance, np.diag([m, m, 0, 0, 0, rad]) ** 2)
    assert np.count_nonzero(odometry_covariance(np.eye(4), False)) == 6
