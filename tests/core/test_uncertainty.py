"""Covariances of edges and chains, by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rbtm_bench.core.geometry import inverse, se2, se3
from rbtm_bench.core.types import Localizability, RegistrationResult
from rbtm_bench.core.uncertainty import (
    SMALLEST_STD,
    UNSEEN_STD,
    chained,
    edge_covariance,
    position_std,
)


def result(**fields) -> RegistrationResult:
    defaults = {"converged": True, "fitness": 0.9, "inlier_rmse": 0.02, "inliers": 100}
    return RegistrationResult(np.eye(4), **{**defaults, **fields})


def test_own_information_is_inverted() -> None:
    information = np.diag([4.0, 16.0, 25.0, 100.0, 400.0, 2500.0])
    found = edge_covariance(result(information=information), planar=False)
    np.testing.assert_allclose(np.diag(found), [1 / 4, 1 / 16, 1 / 25, 1e-2, 1 / 400, 1 / 2500])


def test_correlations_survive() -> None:
    rng = np.random.default_rng(0)
    A = rng.normal(size=(6, 6))
    information = A @ A.T + 10 * np.eye(6)
    found = edge_covariance(result(information=information), planar=False)
    np.testing.assert_allclose(found @ information, np.eye(6), atol=1e-9)


def test_in_the_plane_only_x_y_and_the_turn_are_unsure() -> None:
    information = np.diag([4.0, 16.0, 0.0, 0.0, 0.0, 2500.0])
    found = edge_covariance(result(information=information), planar=True)
    np.testing.assert_allclose(np.diag(found), [0.25, 1 / 16, 0, 0, 0, 1 / 2500])


def test_covariances_are_symmetric_to_the_last_bit() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        J = rng.normal(size=(30, 6))
        edge = edge_covariance(result(information=J.T @ J), planar=False)
        model = edge_covariance(result(information=(J[:9].T @ J[:9])), planar=False)
        T = se3(rng.normal(size=3), Rotation.random(rng=rng).as_matrix())
        for found in (edge, chained(model, T, edge)):
            np.testing.assert_array_equal(found, found.T)


HELD = Localizability(np.diag([0.0, 0.5, 0.25]), lever=2.0)
"""A bare corridor along x."""


def test_localizability_stands_in() -> None:
    """y: 100 inliers of 20 mm, half of them against it: 0.02^2 / 50. The turn, in metres at the
    lever of 2 m: 0.02^2 / 25, in rad a quarter. Along the corridor: as unsure as it gets."""
    expected = [UNSEEN_STD**2, 0.02**2 / 50, 0, 0, 0, 0.02**2 / 25 / 4]
    found = edge_covariance(result(localizability=HELD), planar=True)
    np.testing.assert_allclose(np.diag(found), expected)
    own = result(localizability=HELD, information=1e4 * np.eye(6))
    chosen = edge_covariance(own, planar=True, source="localizability")
    np.testing.assert_allclose(np.diag(chosen), expected)
    np.testing.assert_allclose(np.diag(edge_covariance(own, True))[:2], [1e-4, 1e-4])


def test_singular_information_is_floored_along_its_own_direction() -> None:
    """A corridor at 45 degrees: the scan holds y - x and nothing of x + y."""
    across = np.array([-1.0, 1.0, 0, 0, 0, 0]) / np.sqrt(2)
    turn = np.eye(6)[5]
    information = 1e4 * (np.outer(across, across) + np.outer(turn, turn))
    found = edge_covariance(result(information=information), planar=True)
    along = np.array([1.0, 1.0, 0, 0, 0, 0]) / np.sqrt(2)
    assert along @ found @ along == pytest.approx(UNSEEN_STD**2)
    assert across @ found @ across == pytest.approx(1e-4)
    assert along @ found @ across == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("planar", [True, False])
@pytest.mark.parametrize("nothing", [None, result(), result(information=np.full((6, 6), np.nan))])
def test_nothing_known(nothing, planar) -> None:
    """Predicted, without normals, or of a library that went wrong: no direction is seen."""
    found = edge_covariance(nothing, planar)
    axes = [0, 1, 5] if planar else range(6)
    np.testing.assert_array_equal(found, np.diag([1.0 * (i in axes) for i in range(6)]))


def test_identical_scans_are_not_infinitely_sure() -> None:
    full = Localizability(np.eye(3), 1.0)
    found = edge_covariance(result(localizability=full, inlier_rmse=0.0), planar=True)
    assert found[0, 0] == pytest.approx(SMALLEST_STD**2 / 100)


def test_a_turn_becomes_a_shift_along_the_way() -> None:
    """0.01 rad unsure, then 3 m ahead: 30 mm across, none along; the edge's own comes on top."""
    model = np.zeros((6, 6))
    model[5, 5] = 0.01**2
    edge = np.diag([1e-4, 0, 0, 0, 0, 0])
    found = chained(model, se2(3.0, 0, 0), edge)
    assert found[1, 1] == pytest.approx(0.03**2)
    assert found[0, 0] == pytest.approx(1e-4)
    assert found[5, 5] == pytest.approx(0.01**2)
    assert position_std(found) == pytest.approx(np.sqrt(0.03**2 + 1e-4))


motions = st.tuples(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3, 3)).map(lambda p: se2(*p))
sigmas = st.tuples(*[st.floats(0, 1)] * 3)


@given(first=motions, second=motions, a=sigmas, b=sigmas)
def test_a_chain_in_two_steps_is_the_chain_in_one(first, second, a, b) -> None:
    """Adding an edge that is sure moves the frame only, and there and back changes nothing; the
    covariance stays symmetric and positive."""
    model, edge = (np.diag([s[0], s[1], 0, 0, 0, s[2]]) ** 2 for s in (a, b))
    none = np.zeros((6, 6))
    found = chained(model, first, edge)
    np.testing.assert_allclose(found, found.T, atol=1e-12)
    assert np.linalg.eigvalsh(found).min() > -1e-9
    np.testing.assert_allclose(
        chained(chained(model, first, none), second, none),
        chained(model, first @ second, none),
        atol=1e-9,
    )
    back = chained(chained(model, first, none), inverse(first), none)
    np.testing.assert_allclose(back, model, atol=1e-9)


def test_first_order_agrees_with_sampling() -> None:
    """Ten thousand draws of two unsure edges in a row."""
    rng = np.random.default_rng(1)
    steps = [se2(2.0, 0.5, 0.6), se2(1.0, -1.0, -0.4)]
    std = np.array([0.01, 0.02, 0.005])
    edge = np.diag([*std[:2], 0, 0, 0, std[2]]) ** 2
    predicted = chained(chained(np.zeros((6, 6)), steps[0], edge), steps[1], edge)
    ends = []
    for d, e in rng.normal(size=(10_000, 2, 3)) * std:
        ends.append((steps[0] @ se2(*d) @ steps[1] @ se2(*e))[:2, 3])
    spread = np.sqrt(np.trace(np.cov(np.array(ends).T)))
    assert position_std(predicted) == pytest.approx(spread, rel=0.03)
