"""Which pairs of keyframes are looked at, and why a registered one is not believed."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rbtm_bench.core.geometry import se2
from rbtm_bench.core.types import Array, Localizability, RegistrationResult
from rbtm_bench.loops.position import PositionLoops
from rbtm_bench.loops.similarity import SimilarityLoops, principal
from rbtm_bench.loops.verify import Limits, Pair, Verifier
from rbtm_bench.similarity.range_correlation import RangeCorrelation


def path_of(*places: tuple[float, float, float], step: float = 3.0) -> tuple:
    """A track of keyframes ``step`` m apart along the path, as ``pairs`` looks at it, and their
    poses, wherever they are."""
    poses = np.stack([se2(*place) for place in places])
    return SimpleNamespace(path=step * np.arange(len(poses))), poses


def by_position(track: Any, poses: Array, tried=(), closed=(), **settings) -> list[Pair]:
    return PositionLoops(**settings).pairs(track, poses, tried, np.array(closed, dtype=np.int64))


def test_the_nearest_old_keyframe_within_the_drift() -> None:
    """Keyframe 5 is 15 m after keyframe 0: 2 m and 3 % of 15 m may lie between them."""
    way = path_of((0, 0, 0), (9, 0, 0), (9, 9, 0), (9, 20, 0), (0, 20, 0), (2.4, 0, 0))
    assert by_position(*way) == [Pair(0, 5)]
    assert by_position(*way, drift=0.02) == []
    assert by_position(*way, most_m=2.3) == []
    assert by_position(*way, apart_m=15.0) == [], "not over 15 m"
    assert by_position(*way, tried={Pair(0, 5)}) == []


def test_next_to_loops_less_has_drifted() -> None:
    """Loops at 1 and 4: 0 and 5 are 3 m each from one, so 2 m and 3 % of 6 m."""
    near = path_of((0, 0, 0), (9, 0, 0), (9, 9, 0), (9, 20, 0), (0, 20, 0), (2.17, 0, 0))
    far = path_of((0, 0, 0), (9, 0, 0), (9, 9, 0), (9, 20, 0), (0, 20, 0), (2.19, 0, 0))
    assert by_position(*near, closed=[1, 4]) == [Pair(0, 5)]
    assert by_position(*far, closed=[1, 4]) == [] and by_position(*far) == [Pair(0, 5)]


def test_of_two_in_reach_the_nearer_and_of_equals_the_one_that_looks_the_same_way() -> None:
    far = [(50.0 + 9 * i, 0.0, 0.0) for i in range(4)]
    way = path_of((0, 0, 0), (1, 0, 0), *far, (0.8, 0, 0))
    assert by_position(*way) == [Pair(1, 6), Pair(0, 6)]
    assert by_position(*way, tried={Pair(1, 6)}) == [Pair(0, 6)]
    turned = path_of((0, 0, np.pi), (1, 0, 0), *far, (0.4, 0, 0))
    assert by_position(*turned) == [Pair(1, 6), Pair(0, 6)]


class Words(RangeCorrelation):
    """Scores descriptors by their inner product."""

    def scores(self, window, descriptor):
        return window @ descriptor


def similar(descriptors: list[list[float]], tried=(), **settings) -> list[Pair]:
    loops = SimilarityLoops(apart_m=5.0, **settings)
    loops._similarity = Words()
    loops._descriptors = np.array(descriptors)
    loops._places = principal(loops._descriptors, 2)
    track, poses = path_of(*[(0.0, 0.0, 0.0)] * len(descriptors))
    return loops.pairs(track, poses, tried, np.zeros(0, dtype=np.int64))


def test_the_most_similar_of_long_ago_above_the_threshold() -> None:
    descriptors = [[1.0, 0.0], [0.0, 1.0], [0.6, 0.8], [0.99, 0.1]]
    assert similar(descriptors, threshold=0.7) == [Pair(0, 3)]
    assert similar(descriptors, threshold=0.995) == []
    assert similar(descriptors, tried={Pair(0, 3)}, threshold=0.7) == []
    descriptors.append([0.1, 0.99])
    assert similar(descriptors, threshold=0.7) == [Pair(0, 3), Pair(1, 4)]
    assert similar(descriptors, threshold=0.7, nearest=1) == [Pair(0, 3), Pair(1, 4)]


def test_undefined_scores_pass_for_nothing() -> None:
    assert similar([[1.0, 0.0], [0.0, 1.0], [1.0, np.nan], [np.nan, 1.0]], threshold=0.1) == []


def test_principal_components_keep_what_spreads() -> None:
    rng = np.random.default_rng(0)
    wide, narrow = rng.normal(0, 10, (50, 1)), rng.normal(0, 0.1, (50, 3))
    X = np.hstack([narrow, wide])
    reduced = principal(X, 1)
    assert abs(np.corrcoef(reduced[:, 0], wide[:, 0])[0, 1]) > 0.999
    both = principal(X[:, :2] + 1j * X[:, 2:], 4)
    apart = np.linalg.norm(both[:, None] - both[None], axis=2)
    direct = np.linalg.norm(X[:, None] - X[None], axis=2)
    np.testing.assert_allclose(apart, direct, atol=1e-9)


HELD = Localizability(np.diag([0.5, 0.4, 0.3]), 3.0)
GOOD = RegistrationResult(se2(1, 0, 0), True, 0.9, 0.02, 100, localizability=HELD)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({}, None),
        ({"converged": None}, None),
        ({"converged": False}, "not converged"),
        ({"fitness": 0.64}, "fitness 0.64 < 0.65"),
        ({"inliers": 39}, "39 inliers < 40"),
        ({"localizability": None}, "no surfaces"),
        ({"localizability": Localizability(np.diag([0.5, 0.01, 0.3]), 3.0)}, "held by 0.020"),
        ({"T_target_source": se2(1.39, 0, 0)}, None),
        ({"T_target_source": se2(1.41, 0, 0)}, "4.1 > 4 sigmas from the path"),
        ({"T_target_source": se2(1, 0, -0.21)}, "4.2 > 4 sigmas from the path"),
    ],
)
def test_why_a_loop_is_not_believed(change, reason) -> None:
    """The path is unsure of 0.1 m and 0.05 rad."""
    verifier = Verifier.__new__(Verifier)
    verifier._limits = Limits()
    verifier._track = SimpleNamespace(planar=True, axes=[0, 1, 5])
    unsure = np.diag([0.1, 0.1, 0, 0, 0, 0.05]) ** 2
    given = verifier._rejection(replace(GOOD, **change), se2(1, 0, 0), unsure)
    assert given is None if reason is None else given is not None and given.startswith(reason)
