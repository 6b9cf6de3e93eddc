"""Censi's covariance against the scatter of many noisy registrations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rbtm_bench.backends.plicp import PointToLineICP
from rbtm_bench.contract.scene import cast, planar_scan
from rbtm_bench.core.geometry import inverse, se2, yaw
from rbtm_bench.core.types import Array, RegistrationResult, Scan
from rbtm_bench.datasets.base import beam_points
from rbtm_bench.odometry import judge

PLANAR = np.ix_([0, 1, 5], [0, 1, 5])
METRICS = ("point_to_line", "point_to_point")
START, TRUTH = se2(0.3, -0.2, 0.2), se2(0.1, 0.05, 0.9)
DRAWS = 120
CORRIDOR = np.array([[[-50.0, -1.0], [50.0, -1.0]], [[-50.0, 1.0], [50.0, 1.0]]])


def backend(metric: str, **settings: Any) -> PointToLineICP:
    """As ``plicp`` or ``plicp_p2p``, converged more closely."""
    close: dict[str, Any] = {"epsilon_xy": 1e-6, "epsilon_theta": 1e-6, "max_iterations": 300}
    if metric == "point_to_point":
        close["outliers_refine_multiplier"] = 0.0
    return PointToLineICP(0.3, metric=metric, **(close | settings))  # type: ignore[arg-type]


def register(method: PointToLineICP, source: Scan, target: Scan, T: Array) -> RegistrationResult:
    return judge.register(method, method.prepare(source), method.prepare(target), T)


def corridor_scan(T_world_sensor: Array, index: int, noise: float) -> Scan:
    """A scan of two walls along x without ends, at most 4 m away."""
    angles = np.deg2rad(np.arange(-179.5, 180, 1.0))
    ranges = cast(CORRIDOR, T_world_sensor, angles)
    ranges[ranges > 4.0] = np.nan
    ranges = ranges + noise * np.random.default_rng(index).standard_normal(len(ranges))
    return Scan(index, 0.0, beam_points(ranges, angles), True)


def error_of(result: RegistrationResult, truth: Array) -> Array:
    """d = (x, y, theta) with truth exp(d) = the result: in the source's own frame."""
    E = inverse(truth) @ result.T_target_source
    return np.array([E[0, 3], E[1, 3], float(yaw(E))])


def scatter(method: PointToLineICP, noise: float) -> tuple[Array, Array]:
    """Errors (DRAWS, 3) and covariances (DRAWS, 3, 3) that the method gives, of noisy pairs."""
    errors, covariances = [], []
    for draw in range(DRAWS):
        source = planar_scan(START @ TRUTH, 2 * draw, noise)
        result = register(method, source, planar_scan(START, 2 * draw + 1, noise), TRUTH)
        assert result.information is not None
        errors.append(error_of(result, TRUTH))
        covariances.append(np.linalg.inv(result.information[PLANAR]))
    return np.array(errors), np.array(covariances)


@pytest.mark.parametrize("noise", [0.002, 0.01])
@pytest.mark.parametrize("metric", METRICS)
def test_the_covariance_is_the_scatter(metric: str, noise: float) -> None:
    """DRAWS draws tell a standard deviation to 6 %, three times that is allowed."""
    method = backend(metric, sigma=noise, trim_floor=0.0)  # a floor lets corners in
    errors, covariances = scatter(method, noise)
    seen, given = np.cov(errors.T), covariances.mean(axis=0)
    ratio = np.sqrt(np.diag(given) / np.diag(seen))
    assert ((ratio > 0.8) & (ratio < 1.2)).all(), ratio
    # along any direction, not only along the axes: the eigenvalues of one seen by the other
    along = np.sqrt(np.linalg.eigvals(np.linalg.solve(seen, given)).real)
    assert ((along > 0.7) & (along < 1.3)).all(), along
    # errors in units of it: the mean of chi^2 with 3 degrees of freedom is 3
    squared = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariances), errors)
    assert 2.2 < squared.mean() < 4.5


def test_the_information_is_in_the_frame_of_the_source() -> None:
    """Turning the source's sensor turns its x and y, and nothing else."""
    method = backend("point_to_line")
    source, target = planar_scan(START @ TRUTH, 1, 0.01), planar_scan(START, 2, 0.01)
    turn = se2(0, 0, 1.1)
    points = source.points @ turn[:3, :3]
    other = Scan(1, 0.0, points, True)
    plain = register(method, source, target, TRUTH)
    turned = register(method, other, target, TRUTH @ turn)
    assert plain.information is not None and turned.information is not None
    np.testing.assert_allclose(
        turned.T_target_source, plain.T_target_source @ turn, rtol=0, atol=1e-6
    )
    R = turn[:3, :3]
    expected = R.T @ plain.information[PLANAR] @ R
    np.testing.assert_allclose(turned.information[PLANAR], expected, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("metric", METRICS)
def test_only_the_plane_has_information(metric: str) -> None:
    source, target = planar_scan(START @ TRUTH, 1, 0.01), planar_scan(START, 2, 0.01)
    information = register(backend(metric), source, target, TRUTH).information
    assert information is not None
    assert not information[[2, 3, 4]].any() and not information[:, [2, 3, 4]].any()
    np.testing.assert_array_equal(information, information.T)
    assert np.linalg.eigvalsh(information[PLANAR]).min() > 0


def test_sigma_scales_the_covariance_and_nothing_else() -> None:
    source, target = planar_scan(START @ TRUTH, 1, 0.005), planar_scan(START, 2, 0.005)
    fine, finer, blind = (
        register(backend("point_to_line", sigma=sigma), source, target, TRUTH)
        for sigma in (0.005, 0.0025, 1.0)
    )
    assert fine.information is not None and finer.information is not None
    np.testing.assert_allclose(finer.information, 4 * fine.information, rtol=1e-9)
    assert (finer.T_target_source == fine.T_target_source).all()
    # noise of a metre could have made some of what is seen
    assert blind.information is not None
    assert np.linalg.matrix_rank(blind.information, tol=1e-9) < 3


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("noise", [0.0, 0.001, 0.01])
@pytest.mark.parametrize("heading", [0.0, 0.5 * np.pi, 0.6])
def test_along_a_bare_corridor_there_is_no_information(
    metric: str, noise: float, heading: float
) -> None:
    start, truth = se2(0.0, 0.2, 0.0), se2(0.1, 0.05, heading)
    method = backend(metric, sigma=max(noise, 0.001))
    pair = (corridor_scan(start @ truth, 1, noise), corridor_scan(start, 2, noise))
    information = register(method, *pair, truth).information
    assert information is not None
    along = np.array([np.cos(heading), -np.sin(heading), 0.0])  # the corridor, seen by the source
    across = np.array([np.sin(heading), np.cos(heading), 0.0])
    I = information[PLANAR]  # noqa: E741
    assert across @ I @ across > 1e4, "1 cm across"
    assert I[2, 2] > 1e4, "0.6 deg"
    assert along @ I @ along < 1e-3 * (across @ I @ across)
    values = np.linalg.eigvalsh(I)
    assert values[0] <= 1e-6 * values[1], "one direction is not seen at all"


def test_a_recess_lifts_the_blindness() -> None:
    recess = [[(1, 1), (1, 1.4)], [(1, 1.4), (1.8, 1.4)], [(1.8, 1.4), (1.8, 1)]]
    ends = [[(-50, 1), (1, 1)], [(1.8, 1), (50, 1)], [(-50, -1), (50, -1)]]
    walls = np.array(recess + ends, dtype=float)
    angles = np.deg2rad(np.arange(-179.5, 180, 1.0))
    scans = []
    for index, x in enumerate((0.1, 0.0)):
        ranges = cast(walls, se2(x, 0.2, 0.0), angles)
        ranges[ranges > 4.0] = np.nan
        ranges += 0.005 * np.random.default_rng(index).standard_normal(len(ranges))
        scans.append(Scan(index, 0.0, beam_points(ranges, angles), True))
    result = register(backend("point_to_line", sigma=0.005), *scans, se2(0.1, 0, 0))
    assert result.information is not None
    covariance = np.linalg.inv(result.information[PLANAR])
    assert 0.0005 < np.sqrt(covariance[0, 0]) < 0.01, "some millimetres along the corridor"
    assert covariance[0, 0] > 4 * covariance[1, 1]


def test_little_is_known_of_few_points() -> None:
    """A tenth of the source's beams: up to ten times the variance, for all of the target's noise
    is in it as before, only shared by fewer."""
    method = backend("point_to_line", sigma=0.002)
    traces = []
    for step in (1, 10):
        scans = [planar_scan(START @ TRUTH, 1, 0.002), planar_scan(START, 2, 0.002)]
        scans[0] = Scan(1, 0.0, scans[0].points[::step], True)
        result = register(method, *scans, TRUTH)
        assert result.information is not None
        traces.append(np.trace(np.linalg.inv(result.information[PLANAR])))
    assert 4.0 < traces[1] / traces[0] < 15.0
