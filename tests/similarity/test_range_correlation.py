"""Correlation of range profiles: by hand, against numpy, and turned sensors."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.similarity.range_correlation import RangeCorrelation

NAN = float("nan")
ANGLES = np.radians(np.arange(-90.0, 91.0))


def one(similarity: RangeCorrelation, beams, model: Array, scan: Array) -> float:
    """The score of ranges with beams 1 deg apart."""
    angles = np.radians(np.arange(float(len(model))))
    row, column = (similarity.describe(beams(np.asarray(r), angles)) for r in (model, scan))
    return float(similarity.scores(row[None], column)[0])


def test_by_hand(beams) -> None:
    """Deviations (-1, 0, 1) and (-1, 1, 0): Cov = 1/3, both Var = 2/3."""
    still = RangeCorrelation(0.0)
    assert one(still, beams, [1.0, 2.0, 3.0], [4.0, 6.0, 5.0]) == pytest.approx(0.5)
    assert one(still, beams, [1.0, 2.0, 3.0], [6.0, 4.0, 2.0]) == pytest.approx(-1.0)
    assert one(still, beams, [1.0, 2.0, 3.0], [10.0, 20.0, 30.0]) == pytest.approx(1.0)


def test_a_lag_by_hand(beams) -> None:
    """One beam on: (5, 1, 4) against itself, from the fourth beam on nothing is shared."""
    model, scan = [5.0, 1.0, 4.0, 9.0], [7.0, 5.0, 1.0, 4.0]
    assert one(RangeCorrelation(1.0), beams, model, scan) == pytest.approx(1.0)
    assert one(RangeCorrelation(1.0), beams, scan, model) == pytest.approx(1.0)
    unlagged = np.corrcoef(model, scan)[0, 1]
    assert one(RangeCorrelation(0.4), beams, model, scan) == pytest.approx(unlagged)
    assert unlagged < 0.5


@pytest.mark.parametrize("seed", range(10))
def test_the_score_is_the_highest_corrcoef_over_shared_beams(beams, seed) -> None:
    rng = np.random.default_rng(seed)
    model, scan = rng.uniform(1.0, 60.0, (2, 40))
    model[rng.random(40) < 0.2], scan[rng.random(40) < 0.2] = NAN, NAN
    expected = []
    for lag in range(-4, 5):
        x = model[max(lag, 0) : 40 + min(lag, 0)]
        y = scan[max(-lag, 0) : 40 - max(lag, 0)]
        shared = np.isfinite(x) & np.isfinite(y)
        if shared.sum() >= 0.5 * 40:
            expected.append(np.corrcoef(x[shared], y[shared])[0, 1])
    assert expected
    got = one(RangeCorrelation(4.0, 0.5), beams, model, scan)
    assert got == pytest.approx(max(expected), abs=1e-10)


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("turn", [-25, -7, 0, 7, 25])
def test_a_rotation_is_found_by_its_lag(beams, room, turn, sense) -> None:
    angles = ANGLES[::sense].copy()

    def score(most: float) -> float:
        similarity = RangeCorrelation(most)
        model = similarity.describe(beams(room(angles), angles))
        scan = similarity.describe(beams(room(angles + np.radians(turn)), angles))
        return float(similarity.scores(model[None], scan)[0])

    assert score(abs(turn)) == pytest.approx(1.0, abs=1e-12)
    if turn:
        assert score(abs(turn) - 4.0) < 0.99


@pytest.mark.parametrize(("share", "defined"), [(0.5, True), (0.51, False), (0.0, True)])
def test_too_few_shared_beams_are_undefined(beams, share, defined) -> None:
    """Two of four beams are shared: exactly half is enough. One never is."""
    similarity = RangeCorrelation(0.0, share)
    score = one(similarity, beams, [1.0, 2.0, NAN, 5.0], [3.0, 5.0, 1.0, NAN])
    assert np.isnan(score) != defined
    assert np.isnan(one(similarity, beams, [1.0, NAN, 3.0], [3.0, 5.0, NAN]))


def test_a_lag_takes_beams_away(beams) -> None:
    """Only at a lag of one beam do the two agree, and then three of four are shared."""
    model, scan = [5.0, 1.0, 4.0, 9.0], [7.0, 5.0, 1.0, 4.0]
    assert one(RangeCorrelation(1.0, 0.75), beams, model, scan) == pytest.approx(1.0)
    assert one(RangeCorrelation(1.0, 0.76), beams, model, scan) < 0.5


def test_a_circle_around_the_sensor_is_undefined(beams) -> None:
    similarity = RangeCorrelation(2.0)
    circle, varied = [3.0] * 8, [1.0, 2.0, 4.0, 3.0, 5.0, 2.0, 1.0, 7.0]
    assert np.isnan(one(similarity, beams, circle, varied))
    assert np.isnan(one(similarity, beams, varied, circle))
    assert np.isnan(one(similarity, beams, circle, circle))
    assert np.isnan(one(similarity, beams, [NAN] * 8, varied))


def test_the_beam_spacing_may_not_change(beams) -> None:
    similarity = RangeCorrelation()
    similarity.describe(beams(np.ones(181), ANGLES))
    with pytest.raises(DataError, match="beam spacing changes"):
        similarity.describe(beams(np.ones(181), 0.5 * ANGLES))


def test_clouds_have_no_order_of_sensing() -> None:
    from rbtm_bench.contract.scene import TinyClouds

    with pytest.raises(ConfigError, match="similarity=range_correlation reads beams"):
        RangeCorrelation().check(TinyClouds())
    RangeCorrelation().check(Corridor(scans=2))


def test_a_bare_corridor_looks_the_same_everywhere() -> None:
    """A limit: like every score of scans alone, it cannot tell places along two walls apart."""
    similarity = RangeCorrelation()
    drive = Corridor(environment="bare", scans=21)
    matrix = similarity.matrix(np.stack([similarity.describe(scan) for scan in drive]))
    assert matrix.min() > 0.99


def test_a_scan_of_one_beam_is_refused() -> None:
    scan = Scan(0, 0.0, np.ones((1, 3)), True, np.ones(1), np.zeros(1))
    with pytest.raises(DataError, match="a scan of one beam: expected at least two"):
        RangeCorrelation().describe(scan)
