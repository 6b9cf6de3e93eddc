"""Which pairs are drawn, that the parts are apart, and what is known of pairs beforehand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rbtm_bench.calibration.guesses import disturbed, motions
from rbtm_bench.calibration.parts import (
    CALIBRATION,
    REPORTED,
    clusters_of,
    evenly,
    parts_of,
    span_of,
)
from rbtm_bench.calibration.plan import CalibrationPlan
from rbtm_bench.calibration.reference import known_motions, of_wheels
from rbtm_bench.calibration.sampling import GAP, REVISIT, Sample, draw
from rbtm_bench.calibration.track import Track
from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.geometry import inverse, rotation_angle, se2, translation_norm
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.base import Relations


def line(count: int = 100, step: float = 0.1) -> Array:
    """Poses along x, a step a scan."""
    return np.stack([se2(step * i, 0.0, 0.0) for i in range(count)])


def track(poses: Array | None = None, odometry: Array | None = None, reach: float = 5.0) -> Track:
    truth = line() if poses is None else poses
    return Track(np.arange(len(truth), dtype=float), odometry, truth, reach, True, None)


def scans_of(sample: Sample, part: str) -> set[int]:
    rows = sample.rows[sample.rows["part"] == part]
    return set(rows["target"]) | set(rows["source"])


def test_the_parts_share_no_scan_and_can_be_run() -> None:
    sample = draw(track(), CalibrationPlan(gaps=(1, 5, 10)))
    assert scans_of(sample, CALIBRATION).isdisjoint(scans_of(sample, REPORTED))
    assert {CALIBRATION, REPORTED} == set(sample.rows["part"])
    assert [span_of(sample.part, number) for number in (0, 1)] == [(0, 50), (50, 100)]


def test_scans_without_a_true_pose_are_of_no_part() -> None:
    poses = line(20)
    poses[:14] = np.nan
    part = parts_of(track(poses).known)
    assert part.tolist() == [-1] * 14 + [0, 0, 0, 1, 1, 1]
    assert span_of(part, 0) == (14, 17)
    sample = draw(track(poses), CalibrationPlan())
    assert sample.rows["target"].min() == 14
    assert np.isfinite(sample.truth).all()


def test_every_gap_has_the_same_new_scans() -> None:
    sample = draw(track(), CalibrationPlan(gaps=(1, 3, 8), pairs=20, revisits=0))
    for part in (CALIBRATION, REPORTED):
        rows = sample.rows[sample.rows["part"] == part]
        assert rows.groupby("gap").size().to_dict() == {1: 10, 3: 10, 8: 10}
        assert len({tuple(g["source"]) for _, g in rows.groupby("gap")}) == 1
    # 1 + 3 + 8 pairs have their ends on either side of the cut
    assert sample.counts["pairs that cross the cut"] == 12
    np.testing.assert_allclose(translation_norm(sample.truth), 0.1 * sample.rows["gap"])
    np.testing.assert_allclose(sample.rows["travelled_m"], 0.1 * sample.rows["gap"])


def test_gaps_end_where_scans_no_longer_see_each_other() -> None:
    sample = draw(track(reach=0.65), CalibrationPlan())
    assert sorted(set(sample.rows["gap"])) == [1, 2, 3, 4, 6]
    with pytest.raises(DataError, match="no scan of each part has 60 others"):
        draw(track(), CalibrationPlan(gaps=(1, 60)))
    with pytest.raises(DataError, match="a calibration needs more scans"):
        draw(track(line(2)), CalibrationPlan())


def test_revisits_are_near_in_space_and_far_along_the_path() -> None:
    out = line(60, 0.5)
    poses = np.concatenate([out, out[::-1], out, out[::-1]])
    sample = draw(track(poses, odometry=None), CalibrationPlan(revisits=40, gaps=(1, 2)))
    again = sample.rows[sample.rows["kind"] == REVISIT]
    assert len(again) == 40 and set(again["part"]) == {CALIBRATION, REPORTED}
    assert (again["travelled_m"] >= 10.0).all()
    T = sample.truth[again.index]
    assert (translation_norm(T) <= 2.0).all()
    E = inverse(T) @ sample.guess[again.index]
    np.testing.assert_allclose(translation_norm(E), 0.2)
    np.testing.assert_allclose(np.degrees(rotation_angle(E)), 5.0)
    assert (sample.windows["group"] > 0).all()  # windows offer no revisits


def test_the_same_seed_draws_the_same() -> None:
    out = line(60, 0.5)
    poses = np.concatenate([out, out[::-1]] * 2)
    first, again, other = (draw(track(poses), CalibrationPlan(seed=seed)) for seed in (0, 0, 1))
    assert first.rows.equals(again.rows) and not first.rows.equals(other.rows)
    np.testing.assert_array_equal(first.guess, again.guess)


def test_guess_is_odometry_where_there_is_some() -> None:
    odometry = line(step=0.11)
    sample = draw(track(odometry=odometry), CalibrationPlan(gaps=(5,)))
    assert sample.conditions["guess"] == "odometry"
    np.testing.assert_allclose(translation_norm(sample.guess), 0.55)
    np.testing.assert_allclose(sample.rows["distance_m"], 0.55)


def test_constant_velocity_repeats_the_last_true_step() -> None:
    poses = np.stack([se2(0.01 * i * i, 0.0, 0.0) for i in range(10)])
    T = motions("constant_velocity", track(poses), np.array([2, 0]), np.array([5, 1]))
    # up to scan 4 it is known (0.16), and its step was 0.07: 0.16 + 0.07 - 0.04
    assert T[0, 0, 3] == pytest.approx(0.19)
    np.testing.assert_array_equal(T[1], np.eye(4))  # no step before


def test_disturbances_have_their_size_in_space_too() -> None:
    T = np.tile(np.eye(4), (5, 1, 1))
    for planar in (True, False):
        off = disturbed(T, 0.3, 4.0, planar, np.random.default_rng(0))
        np.testing.assert_allclose(translation_norm(off), 0.3)
        np.testing.assert_allclose(np.degrees(rotation_angle(off)), 4.0)
    assert (off[:, 2, 3] != 0).all()


def test_without_truth_there_is_nothing_to_calibrate_by() -> None:
    with pytest.raises(DataError, match="needs true poses or relations"):
        draw(replace(track(odometry=line()), truth=None), CalibrationPlan())


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        (CalibrationPlan(truth="relations"), "no relations; it has poses"),
        (CalibrationPlan(guess="odometry"), "this data set has no odometry"),
    ],
)
def test_what_a_data_set_cannot_give(plan: CalibrationPlan, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        draw(track(), plan)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gaps": (0,)}, "--gaps"),
        ({"gaps": ()}, "--gaps"),
        ({"pairs": 1}, "--pairs 1: expected at least 2"),
        ({"replicates": -1}, "--replicates -1: expected at least 0"),
        ({"within": (0.0, 1.0)}, "--within"),
        ({"within": (float("nan"), 1.0)}, "--within"),
        ({"disturb": (-1.0, 0.0)}, "--disturb"),
    ],
)
def test_options_out_of_range(options: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        CalibrationPlan(**options)


def relations(pairs: list[tuple[float, float]], step: float = 0.1) -> Relations:
    T = np.stack([se2(step * (b - a), 0.0, 0.0) for a, b in pairs])
    return Relations(np.array([a for a, _ in pairs]), np.array([b for _, b in pairs]), T)


def test_relations_in_a_row_are_one_motion() -> None:
    given = relations([(0, 3), (3, 5), (5, 9), (20, 22), (40, 99)])
    known = known_motions(track(), given, chain=3)
    links = {(t, s): n for t, s, n in zip(known.target, known.source, known.links, strict=True)}
    assert links == {
        (0, 3): 1, (3, 5): 1, (5, 9): 1, (20, 22): 1, (40, 99): 1,
        (0, 5): 2, (3, 9): 2, (0, 9): 3,
    }  # fmt: skip
    np.testing.assert_allclose(
        known.T_target_source[:, 0, 3], 0.1 * (known.source - known.target), atol=1e-12
    )
    assert known.local.tolist().count(False) == 1
    assert len(known_motions(track(), given, chain=1).target) == 5


def test_relations_backwards_and_of_no_scan() -> None:
    known = known_motions(track(), relations([(9, 5), (0.5, 3), (4, 4)]), chain=4)
    assert (known.target.tolist(), known.source.tolist(), known.unmatched) == ([5], [9], 2)
    assert known.T_target_source[0, 0, 3] == pytest.approx(0.4)


def test_relations_that_cross_the_cut_are_of_no_part() -> None:
    given = relations([*((i, i + 2) for i in range(0, 98, 2)), (1, 45), (51, 97), (10, 90)])
    long_track = replace(track(odometry=line(step=0.11)), truth=None, relations=given)
    sample = draw(long_track, CalibrationPlan(chain=2))
    assert sample.conditions["truth"] == "relations"
    assert sample.counts["relations that cross the cut"] == 2  # 48 to 50, 10 to 90
    assert scans_of(sample, CALIBRATION).isdisjoint(scans_of(sample, REPORTED))
    assert sorted(set(sample.rows[sample.rows["kind"] == GAP]["group"])) == [2, 4]
    assert (sample.rows["kind"] == REVISIT).sum() == 2
    assert sorted(set(sample.windows["group"])) == [2, 4]


def test_relations_that_are_the_wheels_motion_choose_nothing() -> None:
    """Those within a millimetre of odometry, which is 2 mm a scan too long; not long ones."""
    log = replace(track(odometry=line(step=0.102)), truth=None)
    copied = relations([(4, 8), (60, 63)], step=0.102)
    given = relations([(0, 3), (10, 12), (4, 8), (60, 63), (1, 90)])
    T = given.T_start_end.copy()
    T[2:4] = copied.T_start_end
    T[4] = se2(0.102 * 89, 0.0, 0.0)
    given = Relations(given.start, given.end, T)
    assert of_wheels(log, given).tolist() == [False, False, True, True, False]
    known = known_motions(log, given, chain=1)
    assert known.of_wheels == 2 and known.target.tolist() == [0, 1, 10]
    sample = draw(replace(log, relations=given), CalibrationPlan(chain=1))
    assert sample.counts["local relations that are the wheels' motion, left out"] == 2
    assert sample.of_wheels is not None and sample.of_wheels.sum() == 2
    assert not of_wheels(replace(log, odometry=None), given).any()


def test_what_is_resampled_together() -> None:
    stamps = np.arange(0.0, 1000.0)
    target, source = np.array([0, 20, 40, 100, 101]), np.array([10, 30, 50, 900, 901])
    revisit = np.array([False, False, False, True, True])
    labels, block_s = clusters_of(stamps, target, source, revisit)
    assert block_s == 30.0
    assert labels[:3].tolist() == [0, 0, 1] and labels[3] == labels[4] > 1
    assert clusters_of(stamps[:80], target[:3], source[:3], revisit[:3])[1] < 6.0


def test_evenly() -> None:
    assert evenly(3, 10).tolist() == [0, 1, 2]
    assert evenly(100, 3).tolist() == [0, 50, 99]
