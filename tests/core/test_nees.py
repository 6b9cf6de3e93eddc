"""NEES and the tangent error, against hand-computed values."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from rbtm_bench.core.geometry import se2, se3
from rbtm_bench.core.uncertainty import PLANE, nees, tangent_error


def test_the_error_is_the_logarithm_in_the_estimate_s_frame() -> None:
    T = se2(3.0, -1.0, 0.7)
    ahead = tangent_error(T, T @ se2(0.1, 0.0, 0.0))
    np.testing.assert_allclose(ahead, [0.1, 0, 0, 0, 0, 0], atol=1e-12)
    # a quarter turn on a circle of radius 1: exp of (pi/2, 0, pi/2)
    d = tangent_error(np.eye(4), se2(1.0, 1.0, np.pi / 2))
    np.testing.assert_allclose(d, [np.pi / 2, 0, 0, 0, 0, np.pi / 2], atol=1e-9)
    roll = se3([0, 0, 0.2], [[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    assert tangent_error(np.eye(4), roll)[3] == pytest.approx(np.pi / 2)


def test_by_hand() -> None:
    """2^2 / 4 + 1 / 1 + 3^2 / 9 = 3; without the third axis 2."""
    error, information = np.array([2.0, 1.0, 3.0]), np.diag([1 / 4, 1.0, 1 / 9])
    assert nees(error, information, np.eye(3)) == pytest.approx(3.0)
    assert nees(error, information, np.eye(3)[:, :2]) == pytest.approx(2.0)
    assert nees(error, np.diag([1 / 4, 1.0, 0.0]), np.eye(3)[:, :2]) == pytest.approx(2.0)


def test_what_is_left_out_may_be_as_unsure_as_it_is() -> None:
    """The marginal of x of [[4, 1], [1, 1]] is 4, not the 3 that a known y would give."""
    information = np.linalg.inv(np.array([[4.0, 1.0], [1.0, 1.0]]))
    assert nees(np.array([2.0, 9.0]), information, np.array([[1.0], [0.0]])) == pytest.approx(1.0)


def test_chi_square_of_an_honest_covariance() -> None:
    random = np.random.default_rng(0)
    A = random.normal(size=(3, 3))
    errors = random.multivariate_normal(np.zeros(3), A @ A.T, 4000)
    values = [nees(e, np.linalg.inv(A @ A.T), np.eye(3)) for e in errors]
    low, high = chi2.ppf([0.001, 0.999], 3 * 4000) / 4000
    assert low < np.mean(values) < high
    assert np.mean(np.array(values) <= chi2.ppf(0.95, 3)) == pytest.approx(0.95, abs=0.01)
    assert PLANE == [0, 1, 5]
