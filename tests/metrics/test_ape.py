"""Ape against values worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rbtm_bench.core.geometry import se2, se3
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.metrics.ape import Ape, is_collinear

NOTHING = {"ape_rmse_m": None, "ape_mean_m": None, "ape_max_m": None}


def test_origin_by_hand(planar):
    truth = planar([(0, 0, 0), (1, 0, 0), (2, 0, 0)])
    estimate = planar([(7, 7, 90), (7, 8.3, 90), (6.6, 9, 90)])
    # Aligned, the estimate reads (0, 0), (1.3, 0), (2, 0.4): errors 0, 0.3 and 0.4.
    assert Ape("origin").evaluate(estimate, truth) == pytest.approx(
        {"ape_rmse_m": np.sqrt(0.25 / 3), "ape_mean_m": 0.7 / 3, "ape_max_m": 0.4}
    )


def test_none_compares_the_frames_as_given(planar):
    truth = planar([(0, 0, 0), (1, 0, 0)])
    estimate = planar([(3, 4, 0), (4, 4, 0)])
    assert Ape("none").evaluate(estimate, truth) == pytest.approx(
        {"ape_rmse_m": 5.0, "ape_mean_m": 5.0, "ape_max_m": 5.0}
    )


def test_umeyama_by_hand(planar):
    truth = planar([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)])
    # Twice as large, turned and moved: the motion is fitted and the scale is not.
    turned = se2(3, -2, 1.0) @ planar([(2, 0, 0), (-2, 0, 0), (0, 2, 0), (0, -2, 0)]).T_world_scan
    assert Ape("umeyama").evaluate(Trajectory(truth.stamps, turned), truth) == pytest.approx(
        {"ape_rmse_m": 1.0, "ape_mean_m": 1.0, "ape_max_m": 1.0}
    )


@pytest.mark.parametrize("theta", [0, 30, 77])
@pytest.mark.parametrize("length", [1e-3, 1.0, 1e4])
def test_umeyama_of_a_straight_path_does_not_exist(planar, theta, length):
    c, s = length * np.cos(np.radians(theta)), length * np.sin(np.radians(theta))
    truth = planar([(c * t, s * t, theta) for t in np.linspace(0, 1, 50)])
    estimate = planar([(t, 0.1 * np.sin(9 * t), 0) for t in np.linspace(0, 1, 50)])
    assert Ape("umeyama").evaluate(estimate, truth) == NOTHING
    assert Ape("origin").evaluate(estimate, truth)["ape_rmse_m"] is not None


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e6])
def test_a_path_is_straight_by_its_shape_whatever_its_size(planar, size):
    """A bend of 1e-8 of the length is none (of both paths: 1e-16), one of a tenth is a bend."""
    share = np.linspace(0.0, 1.0, 20)
    bent, hardly = (
        planar([(size * t, size * bend * t**2, 0) for t in share]).T_world_scan
        for bend in (0.1, 1e-8)
    )
    assert not is_collinear(bent, bent)
    assert is_collinear(hardly, hardly)


def test_umeyama_without_motion_does_not_exist(planar):
    still = planar([(2, 3, 0)] * 5)
    assert Ape("umeyama").evaluate(still, still) == NOTHING


def test_only_poses_with_a_truth_count(planar):
    truth = planar([(0, 0, 0), (1, 0, 0), (2, 0, 0)])
    truth.T_world_scan[1] = np.nan
    estimate = planar([(0, 0, 0), (99, 0, 0), (2, 0.2, 0)])
    assert Ape().evaluate(estimate, truth)["ape_max_m"] == pytest.approx(0.2)


@pytest.mark.parametrize("align", ["origin", "umeyama"])
@settings(
    deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    seed=st.integers(0, 1000),
    shift=st.tuples(*[st.floats(-100, 100)] * 3),
    turn=st.tuples(*[st.floats(-2, 2)] * 3),
)
def test_a_motion_of_the_whole_estimate_changes_nothing(wander, align, seed, shift, turn):
    truth, estimate = wander(15, seed), wander(15, seed + 1)
    motion = se3(shift, Rotation.from_rotvec(turn).as_matrix())
    moved = Trajectory(estimate.stamps, motion @ estimate.T_world_scan)
    before, after = (Ape(align).evaluate(e, truth) for e in (estimate, moved))
    assert after == pytest.approx(before, rel=1e-9, abs=1e-9)


def test_umeyama_is_never_worse_than_origin(wander):
    truth, estimate = wander(30, 1), wander(30, 2)
    fitted, anchored = (Ape(a).evaluate(estimate, truth) for a in ("umeyama", "origin"))
    assert fitted["ape_rmse_m"] <= anchored["ape_rmse_m"]
