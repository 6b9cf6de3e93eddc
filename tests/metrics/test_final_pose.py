"""FinalPose against values worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rbtm_bench.core.geometry import se2, se3
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.metrics.final_pose import FinalPose


def test_straight_path_too_short_and_to_the_left(planar):
    truth = planar([(0, 0, 0), (1, 0, 0), (2, 0, 0)])
    estimate = planar([(0, 0, 0), (1, 0.1, 5), (1.7, 0.4, 10)])
    values = FinalPose().evaluate(estimate, truth)
    assert values == pytest.approx(
        {
            "final_translation_error_mm": 500.0,
            "final_along_mm": -300.0,
            "final_cross_mm": 400.0,
            "final_rotation_error_deg": 10.0,
            "final_heading_error_deg": 10.0,
            "drift_percent": 25.0,
        }
    )


def test_direction_of_travel_is_the_one_at_the_end_not_at_the_start(planar):
    truth = planar([(0, 0, 0), (1, 0, 90), (1, 1, 90)])
    estimate = planar([(0, 0, 0), (1, 0, 90), (1.2, 1.1, 80)])
    values = FinalPose().evaluate(estimate, truth)
    assert values["final_along_mm"] == pytest.approx(100.0)
    assert values["final_cross_mm"] == pytest.approx(-200.0)  # +x is to the right when going +y
    assert values["final_rotation_error_deg"] == pytest.approx(10.0)
    assert values["final_heading_error_deg"] == pytest.approx(-10.0)


def test_first_poses_are_aligned_each_with_its_own(planar):
    truth = planar([(5, 5, 90), (5, 6, 90)])
    estimate = planar([(-3, 2, 180), (-4.1, 2, 180)])
    values = FinalPose().evaluate(estimate, truth)
    assert values["final_translation_error_mm"] == pytest.approx(100.0)
    assert values["final_along_mm"] == pytest.approx(100.0)
    assert values["final_cross_mm"] == pytest.approx(0.0, abs=1e-9)
    assert values["final_rotation_error_deg"] == pytest.approx(0.0, abs=1e-9)


def test_direction_of_travel_skips_a_standstill_with_jitter_at_the_end(planar):
    truth = planar([(0, 0, 0), (1, 0, 0), (1.001, 0.02, 0), (1, -0.02, 0), (1, 0, 0)])
    estimate = planar([(0, 0, 0), (1, 0, 0), (1, 0, 0), (1, 0, 0), (1.1, 0, 0)])
    values = FinalPose().evaluate(estimate, truth)
    assert values["final_along_mm"] == pytest.approx(100.0)
    assert values["final_cross_mm"] == pytest.approx(0.0, abs=1e-9)


def test_no_direction_and_no_drift_without_true_motion(planar):
    truth = planar([(0, 0, 0), (0, 0, 30)])
    estimate = planar([(0, 0, 0), (0.01, 0, 30)])
    values = FinalPose().evaluate(estimate, truth)
    assert values["final_translation_error_mm"] == pytest.approx(10.0)
    assert values["final_along_mm"] is None
    assert values["final_cross_mm"] is None
    assert values["drift_percent"] is None


def test_travel_below_the_setting_has_no_direction_but_a_drift(planar):
    truth = planar([(0, 0, 0), (0.04, 0, 0)])
    estimate = planar([(0, 0, 0), (0.03, 0, 0)])
    values = FinalPose(travel_m=0.05).evaluate(estimate, truth)
    assert values["final_along_mm"] is None
    assert values["drift_percent"] == pytest.approx(25.0)
    assert FinalPose(travel_m=0.02).evaluate(estimate, truth)["final_along_mm"] == pytest.approx(
        -10.0
    )


def test_travel_of_exactly_the_setting_has_a_direction(planar):
    """The last way of 0.5 m goes up; the way before it, which is farther from the end, does not."""
    truth = planar([(0, 0, 0), (4, 0, 0), (4, 0.5, 0)])
    estimate = planar([(0, 0, 0), (4, 0, 0), (4, 0.75, 0)])
    values = FinalPose(travel_m=0.5).evaluate(estimate, truth)
    assert values["final_along_mm"] == pytest.approx(250.0)
    assert values["final_cross_mm"] == pytest.approx(0.0, abs=1e-9)


def test_out_of_the_plane_cross_is_the_norm_of_the_remainder():
    truth = Trajectory(np.arange(2.0), np.array([np.eye(4), se3([0, 0, 2], np.eye(3))]))
    estimate = Trajectory(np.arange(2.0), np.array([np.eye(4), se3([-0.3, 0.4, 2.1], np.eye(3))]))
    values = FinalPose().evaluate(estimate, truth)
    assert values["final_along_mm"] == pytest.approx(100.0)
    assert values["final_cross_mm"] == pytest.approx(500.0)
    assert values["final_heading_error_deg"] == pytest.approx(0.0)


def test_last_pose_is_the_last_with_a_truth(planar):
    truth = planar([(9, 9, 9), (0, 0, 0), (1, 0, 0), (9, 9, 9)])
    truth.T_world_scan[[0, 3]] = np.nan
    estimate = planar([(4, 4, 4), (0, 0, 0), (1.2, 0, 0), (7, 7, 7)])
    values = FinalPose().evaluate(estimate, truth)
    assert values["final_translation_error_mm"] == pytest.approx(200.0)
    assert values["drift_percent"] == pytest.approx(20.0)


@settings(
    deadline=None, max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    seed=st.integers(0, 1000),
    x=st.floats(-50, 50),
    y=st.floats(-50, 50),
    theta=st.floats(-3.2, 3.2),
    flat=st.booleans(),
)
def test_parts_add_up_and_the_world_frame_does_not_matter(wander, seed, x, y, theta, flat):
    truth, estimate = wander(12, seed, flat), wander(12, seed + 1, flat)
    values = FinalPose().evaluate(estimate, truth)
    along, cross = values["final_along_mm"], values["final_cross_mm"]
    assert np.hypot(along, cross) == pytest.approx(values["final_translation_error_mm"])
    moved = Trajectory(estimate.stamps, se2(x, y, theta) @ estimate.T_world_scan)
    assert FinalPose().evaluate(moved, truth) == pytest.approx(values, rel=1e-6, abs=1e-6)
