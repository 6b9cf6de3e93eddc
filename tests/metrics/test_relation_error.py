"""RelationError against values worked out by hand and a known figure on real logs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rbtm_bench.core.geometry import inverse, se2, se3
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.datasets.association import nearest
from rbtm_bench.datasets.base import Relations
from rbtm_bench.metrics.relations import RelationError


def relations(*rows: tuple[float, float, float, float, float]) -> Relations:
    """From rows start s, end s, x m, y m, theta deg."""
    table = np.array(rows, dtype=float).reshape(-1, 5)
    T = np.array([se2(x, y, np.radians(theta)) for _, _, x, y, theta in table])
    return Relations(table[:, 0], table[:, 1], T.reshape(-1, 4, 4))


def test_by_hand(planar):
    estimate = planar([(0, 0, 90), (0, 1.3, 90), (0, 2.3, 80), (0, 3.3, 80)])
    known = relations((0, 1, 1, 0, 0), (1, 2, 1, 0, 0), (0, 3, 3.3, 0.4, -10))
    values = RelationError(local_s=2).evaluate(estimate, None, known)
    # Errors: 0.3 m and 0 deg; 0 m and 10 deg; then, over 3 s, 0.4 m and 0 deg.
    assert values == pytest.approx(
        {
            "relations_used": 3,
            "relations_total": 3,
            "relations_translation_mean_m": 0.7 / 3,
            "relations_translation_std_m": np.std([0.3, 0, 0.4]),
            "relations_rotation_mean_deg": 10 / 3,
            "relations_rotation_std_deg": np.std([0, 10, 0]),
            "relations_local_used": 2,
            "relations_local_total": 2,
            "relations_local_translation_mean_m": 0.15,
            "relations_local_translation_std_m": 0.15,
            "relations_local_rotation_mean_deg": 5.0,
            "relations_local_rotation_std_deg": 5.0,
            "relations_long_used": 1,
            "relations_long_total": 1,
            "relations_long_translation_mean_m": 0.4,
            "relations_long_translation_std_m": 0.0,
            "relations_long_rotation_mean_deg": 0.0,
            "relations_long_rotation_std_deg": 0.0,
        },
        abs=1e-9,
    )


def test_unmatched_ends_are_counted_and_not_used(planar):
    estimate = planar([(0, 0, 0), (1.5, 0, 0)])
    known = relations((0, 1, 1, 0, 0), (0, 1.01, 9, 9, 9), (7, 1, 9, 9, 9), (0, 50, 9, 9, 9))
    values = RelationError().evaluate(estimate, None, known)
    assert (values["relations_used"], values["relations_total"]) == (1, 4)
    assert values["relations_translation_mean_m"] == pytest.approx(0.5)
    assert (values["relations_long_used"], values["relations_long_total"]) == (0, 1)
    assert values["relations_long_translation_mean_m"] is None
    assert values["relations_long_rotation_std_deg"] is None


@pytest.mark.parametrize("poses", [0, 1, 2])
def test_no_relation_matched(planar, poses):
    estimate = planar([(0, 0, 0)] * poses)
    values = RelationError().evaluate(estimate, None, relations((40, 41, 1, 0, 0)))
    assert values["relations_used"] == 0
    assert values["relations_total"] == 1
    assert values["relations_translation_mean_m"] is None


def test_no_relations_give_none(planar):
    estimate = planar([(0, 0, 0), (1, 0, 0)])
    for missing in (None, relations()):
        values = RelationError().evaluate(estimate, None, missing)
        assert list(values) == list(RelationError.columns)
        assert set(values.values()) == {None}


def test_a_scan_without_a_pose_is_not_used(planar):
    estimate = planar([(0, 0, 0), (1, 0, 0), (2, 0, 0)])
    estimate.T_world_scan[1] = np.nan
    known = relations((0, 1, 1, 0, 0), (0, 2, 2, 0, 0))
    values = RelationError().evaluate(estimate, None, known)
    assert (values["relations_used"], values["relations_total"]) == (1, 2)


def test_the_split_looks_at_the_time_between_ends_in_either_direction(planar):
    estimate = planar([(0, 0, 0), (1, 0, 0), (2, 0, 0)])
    known = relations((2, 0, -2, 0, 0), (1, 0, -1, 0, 0))
    values = RelationError(local_s=1).evaluate(estimate, None, known)
    assert (values["relations_local_used"], values["relations_long_used"]) == (1, 1)
    assert values["relations_translation_mean_m"] == pytest.approx(0.0, abs=1e-12)


def test_nearest_by_hand():
    stamps = np.array([5.0, 1.0, 3.0, 1.0])
    times = np.array([0.4, 1.0, 1.9, 2.0, 2.1, 5.4, 6.0])
    assert nearest(stamps, times, 0.5).tolist() == [-1, 1, -1, -1, -1, 0, -1]
    assert nearest(stamps, times, 1.0).tolist() == [1, 1, 1, 1, 2, 0, 0]
    assert nearest(np.array([]), times, 1.0).tolist() == [-1] * 7


@given(
    stamps=st.lists(st.floats(-10, 10), min_size=1, max_size=20),
    times=st.lists(st.floats(-12, 12), max_size=10),
    tolerance=st.floats(1e-6, 3),
)
@settings(deadline=None, max_examples=100)
def test_nearest_agrees_with_brute_force(stamps, times, tolerance):
    s, t = np.array(stamps), np.array(times)
    indices = nearest(s, t, tolerance)
    for time, index in zip(t, indices, strict=True):
        distance = np.abs(s - time)
        if index < 0:
            assert distance.min() > tolerance
        else:
            assert distance[index] == distance.min() <= tolerance


@settings(
    deadline=None, max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    seed=st.integers(0, 1000),
    shift=st.tuples(*[st.floats(-100, 100)] * 3),
    turn=st.tuples(*[st.floats(-2, 2)] * 3),
)
def test_neither_a_motion_nor_the_order_of_the_estimate_changes_anything(wander, seed, shift, turn):
    truth, estimate = wander(20, seed), wander(20, seed + 1)
    rng = np.random.default_rng(seed)
    i, j = rng.integers(0, 20, size=(2, 12))
    T = truth.T_world_scan
    known = Relations(truth.stamps[i], truth.stamps[j], inverse(T[i]) @ T[j])
    motion = se3(shift, Rotation.from_rotvec(turn).as_matrix())
    order = rng.permutation(20)
    moved = Trajectory(estimate.stamps[order], motion @ estimate.T_world_scan[order])
    metric = RelationError(local_s=8)
    before, after = (metric.evaluate(e, None, known) for e in (estimate, moved))
    empty = {key for key, value in before.items() if value is None}
    assert empty == {key for key, value in after.items() if value is None}
    for key in before.keys() - empty:
        assert after[key] == pytest.approx(before[key], rel=1e-6, abs=1e-6), key
    assert before["relations_used"] == 12
    zero = metric.evaluate(truth, None, known)
    assert zero["relations_translation_mean_m"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("log", "count", "long", "mean", "std"),
    [
        ("aces", 1279, 90, 0.549, 2.674),
        ("intel", 2984, 1211, 7.370, 14.349),
        ("mit-csail", 1172, 122, 1.681, 5.292),
    ],
)
def test_wheel_odometry_on_real_logs(data_dir, log, count, long, mean, std):
    """All of the relations count, and odometry alone has its known error."""
    from rbtm_bench.datasets.carmen import Carmen

    folder = data_dir / "freiburg"
    data = Carmen(str(folder / f"{log}.clf.gz"), relations=str(folder / f"{log}.relations"))
    poses = np.stack([scan.odometry for scan in data])
    estimate = Trajectory(np.array([scan.stamp for scan in data]), poses)
    values = RelationError().evaluate(estimate, None, data.relations)
    assert values["relations_used"] == values["relations_total"] == count
    assert values["relations_long_used"] == values["relations_long_total"] == long
    assert values["relations_translation_mean_m"] == pytest.approx(mean, abs=5e-4)
    assert values["relations_translation_std_m"] == pytest.approx(std, abs=5e-4)
