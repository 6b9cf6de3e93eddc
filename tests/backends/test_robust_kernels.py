"""Robust kernels of the three Open3D methods: what they are for, and what their scale means."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rbtm_bench.backends.open3d_gicp import Open3DGeneralizedICP
from rbtm_bench.backends.open3d_icp import Open3DICP
from rbtm_bench.backends.open3d_p2p import Open3DPointToPoint
from rbtm_bench.backends.open3d_p2plane import Open3DPointToPlane
from rbtm_bench.contract.scene import WORLDS
from rbtm_bench.core.geometry import se2, transform
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.odometry import judge

METHODS: list[type[Open3DICP]] = [Open3DPointToPoint, Open3DPointToPlane, Open3DGeneralizedICP]
SCALES = {"huber": 0.05, "cauchy": 0.05, "geman_mcclure": 0.05, "tukey": 0.1}
"""m; a generalized ICP's distances are about (2 epsilon)^-0.5 times as large."""

TRUTH = se2(0.05, 0.03, 0.03)


@pytest.fixture(scope="module")
def pair() -> tuple[Scan, Scan, Scan]:
    """Source, source with a quarter of its points moved aside alike, target."""
    world = WORLDS["2d"]
    source = world.scan(world.start @ TRUTH, 1, 0.005)
    target = world.scan(world.start, 2, 0.005)
    points = source.points.copy()
    points[np.random.default_rng(5).random(len(points)) < 0.25, :2] += [0.25, 0.15]
    return source, replace(source, points=points), target


def shift(method: Open3DICP, source: Scan, target: Scan, points: Array) -> float:
    """How far, in m on average, the registration puts points from where they belong."""
    prepared, model = method.prepare(source), method.prepare(target)
    T = judge.register(method, prepared, model, np.eye(4)).T_target_source
    off = transform(T, points) - transform(TRUTH, points)
    return float(np.linalg.norm(off, axis=1).mean())


def build(cls: type[Open3DICP], kernel: str, scale: float) -> Open3DICP:
    factor = 10.0 if cls is Open3DGeneralizedICP else 1.0
    settings: dict[str, Any] = {"kernel": kernel, "kernel_scale": factor * scale}
    return cls(0.5, max_iterations=100, **settings)


@pytest.mark.parametrize("kernel", list(SCALES))
@pytest.mark.parametrize("cls", METHODS)
def test_a_kernel_reduces_the_harm_of_outliers(
    cls: type[Open3DICP], kernel: str, pair: tuple[Scan, Scan, Scan]
) -> None:
    clean, outliers, target = pair
    plain = shift(build(cls, "none", 1.0), outliers, target, clean.points)
    robust = shift(build(cls, kernel, SCALES[kernel]), outliers, target, clean.points)
    assert plain > 0.05
    assert robust < 0.6 * plain, f"{1000 * robust:.1f} mm, {1000 * plain:.1f} mm without a kernel"


@pytest.mark.parametrize("kernel", list(SCALES))
@pytest.mark.parametrize("cls", METHODS)
def test_a_kernel_does_no_harm_without_outliers(
    cls: type[Open3DICP], kernel: str, pair: tuple[Scan, Scan, Scan]
) -> None:
    clean, _, target = pair
    assert shift(build(cls, kernel, SCALES[kernel]), clean, target, clean.points) < 0.015


@pytest.mark.parametrize("kernel", list(SCALES))
def test_point_to_point_with_a_wide_kernel_is_plain_point_to_point(
    kernel: Any, pair: tuple[Scan, Scan, Scan]
) -> None:
    """The detour through generalized ICP changes nothing but the weights."""
    clean, _, target = pair
    stop = {"max_iterations": 200, "relative_fitness": 1e-12, "relative_rmse": 1e-12}
    plain, wide = (
        Open3DPointToPoint(0.5, kernel=k, kernel_scale=1e4, **stop)  # type: ignore[arg-type]
        for k in ("none", kernel)
    )
    T = [judge.register(b, b.prepare(clean), b.prepare(target), np.eye(4)) for b in (plain, wide)]
    np.testing.assert_allclose(T[1].T_target_source, T[0].T_target_source, atol=1e-9)


@pytest.mark.parametrize("kernel", list(SCALES))
def test_the_scale_is_a_length(kernel: Any) -> None:
    """Residual and scale in cm give the same relative weights as in m."""
    weights = []
    for unit in (1.0, 100.0):
        loss = Open3DPointToPoint(0.5, kernel=kernel, kernel_scale=0.1 * unit).robust_kernel()
        weights.append([loss.weight(r * unit) / loss.weight(0.0) for r in (0.05, 0.1, 0.3)])
    np.testing.assert_allclose(weights[1], weights[0], atol=1e-12)
    assert weights[0][2] < 0.35 < 0.5 < weights[0][0]
