"""Pairs with a known motion, and what backends make of them."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.backends.base import Alignment, Backend, Prepared
from rbtm_bench.calibration.known_pairs import (
    KnownPair,
    disturbed,
    errors_of,
    pairs_of,
    register_all,
)
from rbtm_bench.contract.scene import TinyClouds
from rbtm_bench.core.errors import BackendError, DataError
from rbtm_bench.core.geometry import inverse, se2, se3
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.corridor import Corridor


class Counting(Backend):
    """Hands back the guess, counts what it prepares, and refuses scan 3 as a source."""

    def __init__(self) -> None:
        super().__init__(0.3)
        self.built = 0

    def build(self, points: Array, planar: bool) -> None:
        self.built += 1

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        if source.key[0][0] == 3:
            raise BackendError("not this one")
        return Alignment(T_target_source)


@pytest.fixture(scope="module")
def corridor() -> Corridor:
    return Corridor(scans=10)


def test_pairs_carry_the_true_motion(corridor: Corridor) -> None:
    pairs = pairs_of(corridor, gap=3)
    assert [(p.target.index, p.source.index) for p in pairs] == [(i, i + 3) for i in range(7)]
    for pair in pairs:
        G = [s.ground_truth for s in (pair.target, pair.source)]
        np.testing.assert_array_equal(pair.T_target_source, inverse(G[0]) @ G[1])
        assert pair.T_target_source[0, 3] == pytest.approx(3 * 1.8 / 9, abs=1e-6)


def test_at_most_so_many_spread_over_the_whole(corridor: Corridor) -> None:
    assert [p.target.index for p in pairs_of(corridor, 1, 3)] == [0, 4, 8]
    assert len(pairs_of(corridor, 1, 100)) == 9


def test_without_truth_there_are_no_pairs(corridor: Corridor) -> None:
    with pytest.raises(DataError, match="no two scans 1 apart have ground truth"):
        pairs_of(TinyClouds())
    with pytest.raises(DataError, match="no two scans 10 apart"):
        pairs_of(corridor, gap=10)


def test_errors_by_hand() -> None:
    metres, degrees = errors_of(se2(1.3, 0.4, np.deg2rad(-20)), se2(1.0, 0.0, np.deg2rad(10)))
    assert (metres, degrees) == (pytest.approx(0.5), pytest.approx(30.0))


def test_a_scan_is_prepared_once_for_neighbours_and_a_failure_is_an_outcome(
    corridor: Corridor,
) -> None:
    pairs, backend = pairs_of(corridor)[:5], Counting()
    outcomes = list(register_all(backend, pairs, [p.T_target_source for p in pairs]))
    assert backend.built == 6
    assert [o.reason for o in outcomes] == ["", "", "not this one", "", ""]
    assert outcomes[0].within(1e-9, 1e-9) and not outcomes[2].within(1e9, 360.0)


def test_scans_of_two_data_sets_are_not_taken_for_each_other(corridor: Corridor) -> None:
    other = pairs_of(Corridor(scans=10, seed=1))
    backend = Counting()
    pairs = [pairs_of(corridor)[0], other[0]]
    list(register_all(backend, pairs, [np.eye(4)] * 2))
    assert backend.built == 4


@pytest.mark.parametrize("planar", [True, False])
def test_wrong_guesses_are_wrong_by_as_much_as_asked(planar: bool) -> None:
    scan = Scan(0, 0.0, np.zeros((6, 3)), planar)
    pair = KnownPair(scan, scan, se3([1.0, 2.0, 0.0], np.eye(3)), None)
    random = np.random.default_rng(0)
    guesses = [disturbed(pair, 0.5, 20.0, random) for _ in range(20)]
    off = np.array([errors_of(T, pair.T_target_source) for T in guesses])
    np.testing.assert_allclose(off, [[0.5, 20.0]] * 20, atol=1e-9)
    assert len({T.tobytes() for T in guesses}) == 20
    assert all(bool(T[2, 3] == 0.0) is planar for T in guesses)
