"""What ``perturb`` does to a data set: what was asked for, the same every time, and no more."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.geometry import inverse, se2, translation_norm, yaw
from rbtm_bench.core.types import Scan
from rbtm_bench.datasets.base import Dataset, Relations
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.datasets.degraded import Degradation, Degraded, biased, degraded
from rbtm_bench.datasets.movers import PASS, cylinder
from rbtm_bench.datasets.simulated import SimulatedPlace

PLANE = Corridor(scans=61, beams=181)
SPACE = SimulatedPlace(scans=6, beams=16, azimuths=128)
seeds = st.integers(0, 2**31)
shares = st.floats(0.0, 0.9)
both = pytest.mark.parametrize("plain", [PLANE, SPACE], ids=["2d", "3d"])


def made(plain: Dataset, seed: int = 0, **by: Any) -> Dataset:
    return degraded(plain, Degradation(**by), seed)


def same(one: Scan, other: Scan) -> bool:
    ours, theirs = one.arrays(), other.arrays()
    facts = (one.index, one.stamp, one.planar) == (other.index, other.stamp, other.planar)
    bits = ours.keys() == theirs.keys() and all(
        ours[k].tobytes() == theirs[k].tobytes() for k in ours
    )
    return facts and bits


def changes() -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries(
        {},
        optional={
            "dropout": shares,
            "outliers": shares,
            "blocked": shares,
            "movers": st.integers(0, 4),
            "first_scan": st.integers(0, 1),
            "end_scan": st.integers(5, 99),
            "every_scan": st.integers(1, 3),
            "every_beam": st.integers(1, 4),
            "odometry_scale": st.floats(-0.5, 0.5),
            "odometry_drift_deg": st.floats(-5.0, 5.0),
        },
    )


@both
@settings(max_examples=25, deadline=None)
@given(by=changes(), seed=seeds)
def test_whatever_is_done_scans_fit_together(plain: Dataset, by: dict[str, Any], seed: int) -> None:
    one, again = made(plain, seed, **by), made(plain, seed, **by)
    assert one.fingerprint() == again.fingerprint()
    for index in (len(one) - 1, 0):
        scan, was = one[index], plain[by.get("first_scan", 0) + index * by.get("every_scan", 1)]
        assert same(scan, again[index]) and scan.index == index and scan.stamp == was.stamp
        assert scan.ground_truth is not None and was.ground_truth is not None
        assert np.array_equal(scan.ground_truth, was.ground_truth)
        assert np.isfinite(scan.points).all()
        if scan.ranges is not None and scan.angles is not None:
            hit = np.isfinite(scan.ranges)
            assert len(scan.ranges) == len(scan.angles) and len(scan.points) == hit.sum()
            assert np.allclose(np.linalg.norm(scan.points, axis=1), scan.ranges[hit])
        if was.times is not None:
            assert scan.times is not None and len(scan.times) == len(scan.points)
            assert (np.diff(scan.times) >= 0).all()


@both
def test_nothing_done_is_the_data_set_itself(plain: Dataset) -> None:
    assert made(plain) is plain
    assert made(plain, dropout=0.0, every_scan=1, movers=0) is plain
    wrapped = Degraded(plain, Degradation(), 0)
    assert all(same(one, other) for one, other in zip(wrapped, plain, strict=True))


@both
def test_what_one_effect_does_leaves_the_rest(plain: Dataset) -> None:
    """Points that are kept are the same bits, and the odometry is as it was."""
    scan, was = made(plain, dropout=0.5)[3], plain[3]
    rows = {row.tobytes() for row in was.points}
    assert all(row.tobytes() in rows for row in scan.points)
    assert np.array_equal(scan.odometry, was.odometry)
    biased_alone = made(plain, odometry_scale=0.1)[3]
    assert same(replace(biased_alone, odometry=was.odometry), was)
    assert not np.array_equal(biased_alone.odometry, was.odometry)


@both
@pytest.mark.parametrize("key", ["dropout", "blocked"])
@settings(max_examples=10, deadline=None)
@given(seed=seeds, less=shares, more=shares)
def test_a_larger_share_loses_what_a_smaller_one_does(
    plain: Dataset, key: str, seed: int, less: float, more: float
) -> None:
    less, more = sorted((less, more))
    many, few = (
        {row.tobytes() for row in made(plain, seed, **{key: share})[1].points}
        for share in (less, more)
    )
    assert few <= many


@both
def test_shares_are_what_was_asked_for(plain: Dataset) -> None:
    was = sum(len(plain[i].points) for i in range(6))
    for share in (0.1, 0.3):
        left = sum(len(made(plain, dropout=share)[i].points) for i in range(6))
        assert left / was == pytest.approx(1 - share, abs=0.04)
        moved = [made(plain, outliers=share)[i].points for i in range(6)]
        off = [(np.abs(moved[i] - plain[i].points).max(axis=1) > 1e-9).sum() for i in range(6)]
        assert sum(off) / was == pytest.approx(share, abs=0.04)


@both
def test_outliers_stay_on_their_rays_and_within_reach(plain: Dataset) -> None:
    scan, was = made(plain, outliers=1.0)[2], plain[2]
    assert np.allclose(np.cross(scan.points, was.points), 0.0, atol=1e-9)
    assert ((scan.points * was.points).sum(axis=1) > 0).all()
    reach = np.linalg.norm(was.points, axis=1).max()
    assert np.linalg.norm(scan.points, axis=1).max() <= reach + 1e-9


@both
def test_blocked_bearings_stay_blocked(plain: Dataset) -> None:
    one = made(plain, blocked=0.3)
    sectors = [
        set(((np.arctan2(s.points[:, 1], s.points[:, 0]) / (2 * np.pi) + 0.5) * 180).astype(int))
        for s in one
    ]
    assert 0.55 < len(set.union(*sectors)) / (128 if plain is SPACE else 121) < 0.85


def test_thinner_beams() -> None:
    scan, was = made(PLANE, every_beam=3)[5], PLANE[5]
    assert scan.ranges is not None and was.ranges is not None
    assert np.array_equal(scan.ranges, was.ranges[::3], equal_nan=True)
    cloud = made(SPACE, every_beam=4)[2]
    height = np.rad2deg(
        np.arctan2(cloud.points[:, 2], np.hypot(cloud.points[:, 0], cloud.points[:, 1]))
    )
    assert set(height.round(6)) == {-15.0, -7.0, 1.0, 9.0}  # of 16 from -15 to 15


def test_rings_that_cannot_be_told_are_bands() -> None:
    class Bumpy(Dataset):
        def __len__(self) -> int:
            return 2

        def __getitem__(self, index: int) -> Scan:
            return Scan(index, 0.1 * index, np.random.default_rng(index).uniform(1, 9, (4000, 3)))

        def fingerprint(self) -> str:
            return "bumpy"

    thin = made(Bumpy(), every_beam=2)[1]
    assert len(thin.points) / 4000 == pytest.approx(0.5, abs=0.05)


def test_every_third_scan() -> None:
    one = made(PLANE, every_scan=3)
    assert len(one) == 21 and [s.stamp for s in one] == [PLANE[i].stamp for i in range(0, 61, 3)]
    assert same(replace(one[4], index=12), PLANE[12])
    with pytest.raises(IndexError):
        one[21]
    late = replace_scored(PLANE, 7)
    assert made(late, every_scan=3).scored_from == 3
    # what is drawn for a scan does not depend on the others
    both_ways = made(PLANE, every_scan=3, dropout=0.2)[4], made(PLANE, dropout=0.2)[12]
    assert both_ways[0].points.tobytes() == both_ways[1].points.tobytes()


def replace_scored(plain: Dataset, first: int) -> Dataset:
    wrapped = Degraded(plain, Degradation(), 0)
    wrapped.scored_from = first
    return wrapped


def test_biased_odometry_by_hand() -> None:
    line = np.stack([se2(0.5 * i, 0, 0) for i in range(5)])
    long = biased(line, 0.1, 0.0)
    np.testing.assert_allclose(long[-1], se2(2.2, 0, 0), atol=1e-12)
    still = biased(line, -1.0, 0.0)
    np.testing.assert_allclose(still[:, :3, 3], np.broadcast_to(line[0, :3, 3], (len(line), 3)))
    turning = biased(line, 0.0, np.deg2rad(4.0))
    steps = inverse(turning[:-1]) @ turning[1:]
    np.testing.assert_allclose(translation_norm(steps), 0.5)
    np.testing.assert_allclose(np.rad2deg(yaw(steps)), 2.0)
    np.testing.assert_array_equal(biased(line, 0.3, 0.1)[0], line[0])


def test_a_ray_meets_a_cylinder_by_hand() -> None:
    rays = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0.6, 0, 0.8], [0.8, 0, -0.6]])
    found = cylinder(rays, np.array([5.0, 0.0, 0.0]), 1.0)
    np.testing.assert_allclose(found, [4.0, np.nan, np.nan, np.nan, 5.0])
    beside = cylinder(rays[:1], np.array([5.0, 0.6, 0.0]), 1.0)
    np.testing.assert_allclose(beside, 4.2)
    assert np.isnan(cylinder(rays, np.array([0.5, 0.0, 0.0]), 1.0)).all()


def test_movers_hide_what_is_behind_them_and_move_in_the_world() -> None:
    plain = Corridor(scans=121, beams=681, range_noise=0.0)
    one = made(plain, movers=6)
    seen = {}
    for i in range(PASS):
        now, was = one[i].ranges, plain[i].ranges
        assert now is not None and was is not None
        changed = ~((now == was) | (np.isnan(now) & np.isnan(was)))
        assert (now[changed] < np.where(np.isnan(was[changed]), np.inf, was[changed])).all()
        seen[i] = changed.sum()
    assert sum(count > 0 for count in seen.values()) > PASS // 2
    again = made(plain, movers=6)  # in another order
    assert same(again[100], one[100]) and same(again[3], one[3])
    assert not same(made(plain, 1, movers=6)[3], one[3])


def test_truth_and_relations_stay() -> None:
    class Related(Corridor):
        @property
        def relations(self) -> Relations:
            return Relations(np.zeros(1), np.ones(1), np.eye(4)[None])

    plain = Related(scans=20, beams=61)
    one = made(plain, dropout=0.2, every_scan=2)
    assert one.relations is not None and len(one.relations) == 1 and one.has_ground_truth
    (reading,) = one.readings
    assert "dropout 0.2, every_scan 2" in str(reading)


def test_what_cannot_be_done() -> None:
    class Blind(Corridor):
        has_odometry = False

    with pytest.raises(ConfigError, match=r"perturb.odometry_scale=0.1: .* no odometry"):
        made(Blind(scans=5, beams=61), odometry_scale=0.1)
    with pytest.raises(ConfigError, match=r"perturb.every_scan=99: there are 61 scans"):
        made(PLANE, every_scan=99)
    with pytest.raises(ConfigError, match=r"perturb.first_scan=60, perturb.end_scan=70: there are"):
        made(PLANE, first_scan=60, end_scan=70)


@pytest.mark.parametrize(
    "by",
    [{"dropout": 0.1}, {"outliers": 0.1}, {"blocked": 0.1}, {"movers": 1}, {"every_scan": 2},
     {"every_beam": 2}, {"odometry_scale": 0.1}, {"odometry_drift_deg": 1.0}],
)  # fmt: skip
def test_every_setting_and_the_seed_are_in_the_fingerprint(by: dict[str, Any]) -> None:
    prints = {made(PLANE, seed, **words).fingerprint() for seed, words in ((0, by), (1, by))}
    assert len(prints | {PLANE.fingerprint()}) == 3
