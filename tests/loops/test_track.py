"""What a path adds up to between two of its places."""

from __future__ import annotations

import numpy as np

from rbtm_bench.core.geometry import inverse, se2
from rbtm_bench.core.types import Edge, Step, StepRecord
from rbtm_bench.core.uncertainty import FLOOR_M, FLOOR_RAD, FLOOR_SHARE, chained, inflated
from rbtm_bench.loops.base import Route
from rbtm_bench.loops.track import Track

UNSURE = np.diag([0.1, 0.2, 0.0, 0.0, 0.0, 0.05]) ** 2


def route_of(links: list[tuple[int, int]]) -> Route:
    """Scans 10, 11, ... each 1 m on and 0.1 rad further round, hung on the given ones."""
    poses = [np.eye(4)]
    for _ in links:
        poses.append(poses[-1] @ se2(1.0, 0.0, 0.1))
    route = Route()
    route.add(Step(StepRecord(10, 0.0), (), poses[0]))
    for scan, (model, end) in enumerate(links, start=1):
        T = inverse(poses[model]) @ poses[end]
        edge = Edge(10 + model, 10 + end, T, covariance=UNSURE)
        route.add(Step(StepRecord(10 + scan, 0.0), (edge,), poses[end]))
    return route


def test_floor_by_hand() -> None:
    """5 mm and 1 % of 2 m; 2 mrad and 1 % of 0.5 rad."""
    grown = inflated(np.zeros((6, 6)), se2(2.0, 0.0, -0.5), True)
    m, rad = FLOOR_M + 2 * FLOOR_SHARE, FLOOR_RAD + 0.5 * FLOOR_SHARE
    np.testing.assert_allclose(np.diag(grown), [m**2, m**2, 0, 0, 0, rad**2])
    assert np.count_nonzero(inflated(np.zeros((6, 6)), np.eye(4), False)) == 6


def test_along_a_chain_covariances_are_chained() -> None:
    track = Track(route_of([(0, 1), (1, 2), (2, 3), (3, 4)]), True, 0.5, 90.0)
    step, own = se2(1.0, 0.0, 0.1), inflated(UNSURE, se2(1.0, 0.0, 0.1), True)
    expected = chained(chained(own, step, own), step, own)
    for model in (0, 1):  # the same wherever it begins
        T, covariance = track.between(model, model + 3)
        np.testing.assert_allclose(T, step @ step @ step, atol=1e-12)
        np.testing.assert_allclose(covariance, expected, atol=1e-12)


def test_two_branches_add_up() -> None:
    """2 and 3 hang on 1: what is unsure between them is their own two edges."""
    track = Track(route_of([(0, 1), (1, 2), (1, 3)]), True, 0.5, 90.0)
    _, covariance = track.between(2, 3)
    T_2_3 = inverse(track.T_world_scan[2]) @ track.T_world_scan[3]
    near, far = se2(1.0, 0.0, 0.1), se2(1.0, 0.0, 0.1) @ se2(1.0, 0.0, 0.1)
    expected = chained(inflated(UNSURE, near, True), T_2_3, inflated(UNSURE, far, True))
    np.testing.assert_allclose(covariance, expected, atol=1e-12)
    _, none = track.between(3, 3)
    np.testing.assert_allclose(none, np.zeros((6, 6)), atol=1e-12)


def test_keyframes_and_the_path_between_them() -> None:
    route = route_of([(i, i + 1) for i in range(6)])
    by_distance = Track(route, True, 1.5, 180.0)
    assert by_distance.keyframes.tolist() == [0, 2, 4, 6]
    chord = np.linalg.norm((se2(1, 0, 0.1) @ se2(1, 0, 0.1))[:2, 3])
    np.testing.assert_allclose(by_distance.path, chord * np.arange(4))
    by_turn = Track(route, True, 100.0, np.degrees(0.29))
    assert by_turn.keyframes.tolist() == [0, 3, 6]
