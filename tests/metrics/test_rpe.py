"""Rpe against values worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rbtm_bench.core.geometry import se3
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.metrics.rpe import Rpe

NOTHING = {"rpe_translation_rmse_m": None, "rpe_rotation_rmse_deg": None}


def test_consecutive_by_hand(planar):
    truth = planar([(0, 0, 0), (1, 0, 0), (2, 0, 0)])
    # The first motion is 0.3 m too long and turns by 6 deg, the second is 0.4 m too long.
    c, s = np.cos(np.radians(6)), np.sin(np.radians(6))
    estimate = planar([(0, 0, 0), (1.3, 0, 6), (1.3 + 1.4 * c, 1.4 * s, 6)])
    assert Rpe().evaluate(estimate, truth) == pytest.approx(
        {
            "rpe_translation_rmse_m": np.sqrt((0.3**2 + 0.4**2) / 2),
            "rpe_rotation_rmse_deg": np.sqrt(36 / 2),
        }
    )


def test_pairs_follow_one_another_or_overlap(planar):
    truth = planar([(x, 0, 0) for x in range(5)])
    estimate = planar([(0, 0, 0), (1, 0, 0), (2.5, 0, 0), (3.5, 0, 0), (4.5, 0, 0)])
    # delta 2: 0-2 and 2-4 are off by 0.5 and 0; overlapping, 1-3 joins with 0.5.
    apart = Rpe(delta=2).evaluate(estimate, truth)
    assert apart["rpe_translation_rmse_m"] == pytest.approx(np.sqrt(0.25 / 2))
    overlapping = Rpe(delta=2, all_pairs=True).evaluate(estimate, truth)
    assert overlapping["rpe_translation_rmse_m"] == pytest.approx(np.sqrt(0.5 / 3))


@pytest.mark.parametrize("all_pairs", [False, True])
def test_a_delta_beyond_the_last_frame_gives_none(planar, all_pairs):
    path = planar([(x, 0, 0) for x in range(5)])
    assert Rpe(delta=5, all_pairs=all_pairs).evaluate(path, path) == NOTHING
    exact = Rpe(delta=4, all_pairs=all_pairs).evaluate(path, path)
    assert exact == pytest.approx({"rpe_translation_rmse_m": 0.0, "rpe_rotation_rmse_deg": 0.0})


def test_truth_with_six_digits_is_good_enough(wander):
    exact = wander(30, seed=3)
    rough = Trajectory(exact.stamps, exact.T_world_scan.round(6))
    values = Rpe().evaluate(exact, rough)
    assert values == pytest.approx(
        {"rpe_translation_rmse_m": 0.0, "rpe_rotation_rmse_deg": 0.0}, abs=1e-4
    )


@settings(
    deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    seed=st.integers(0, 1000),
    shift=st.tuples(*[st.floats(-100, 100)] * 3),
    turn=st.tuples(*[st.floats(-2, 2)] * 3),
    delta=st.integers(1, 6),
)
def test_the_world_frames_cancel(wander, seed, shift, turn, delta):
    truth, estimate = wander(15, seed), wander(15, seed + 1)
    motion = se3(shift, Rotation.from_rotvec(turn).as_matrix())
    moved = Trajectory(estimate.stamps, motion @ estimate.T_world_scan)
    before, after = (Rpe(delta).evaluate(e, truth) for e in (estimate, moved))
    assert after == pytest.approx(before, rel=1e-6, abs=1e-6)
