"""Open3D's symmetric ICP: known motions, kernels, and what its second normal is for."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from rbtm_bench.backends.open3d_p2plane import Open3DPointToPlane
from rbtm_bench.backends.open3d_symmetric import Open3DSymmetric
from rbtm_bench.contract.scene import WORLDS, World, rotation
from rbtm_bench.core.geometry import inverse, rotation_angle, se2, se3, transform, translation_norm
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.odometry import judge


def off(T: Array, truth: Array) -> tuple[float, float]:
    """m and deg from the truth."""
    error = inverse(truth) @ T
    return float(translation_norm(error)), math.degrees(float(rotation_angle(error)))


def register(method: Open3DPointToPlane, source: Scan, target: Scan, guess: Array) -> Array:
    return judge.register(
        method, method.prepare(source), method.prepare(target), guess
    ).T_target_source


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("motion", ["forward", "left", "turn", "curve", "from_far_guess"])
@pytest.mark.parametrize("world", list(WORLDS.values()), ids=str)
def test_known_motions(world: World, motion: str, noise: float) -> None:
    known = world.motions[motion]
    source, target = world.pair(known, noise)
    forth = register(Open3DSymmetric(0.5), source, target, known.guess)
    back = register(Open3DSymmetric(0.5), target, source, inverse(known.guess))
    for T, truth in ((forth, known.T_target_source), (back, inverse(known.T_target_source))):
        metres, degrees = off(T, truth)
        assert metres < 0.01 and degrees < 0.15


def test_the_second_normal_sees_the_turn_sooner() -> None:
    """One step from 17 deg off, on a curved wall: where the tangent at the target leaves the curve
    to one side, that at the source leaves it to the other."""
    turn = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    ellipse = np.column_stack([3.0 * np.cos(turn), 1.5 * np.sin(turn), np.zeros_like(turn)])
    truth = se2(0.1, -0.05, 0.3)
    target = Scan(0, 0.0, ellipse, True)
    source = Scan(1, 0.1, transform(inverse(truth), ellipse), True)
    plane, symmetric = (
        off(register(cls(1.0, max_iterations=1), source, target, np.eye(4)), truth)[1]
        for cls in (Open3DPointToPlane, Open3DSymmetric)
    )
    assert symmetric < 0.5 * plane < 2.0


@pytest.mark.parametrize("kernel", ["huber", "cauchy", "geman_mcclure", "tukey"])
def test_a_kernel_reduces_the_harm_of_outliers(kernel: str) -> None:
    world, truth = WORLDS["2d"], se2(0.05, 0.03, 0.03)
    source = world.scan(world.start @ truth, 1, 0.005)
    target = world.scan(world.start, 2, 0.005)
    points = source.points.copy()
    points[np.random.default_rng(5).random(len(points)) < 0.25, :2] += [0.25, 0.15]
    spoilt = replace(source, points=points)
    robust = Open3DSymmetric(0.5, max_iterations=100, kernel=kernel, kernel_scale=0.05)  # type: ignore[arg-type]
    plain = off(register(Open3DSymmetric(0.5), spoilt, target, np.eye(4)), truth)[0]
    assert plain > 0.05
    assert off(register(robust, spoilt, target, np.eye(4)), truth)[0] < 0.5 * plain


def test_coarse_to_fine_arrives_where_one_distance_does_not() -> None:
    world, truth = WORLDS["2d"], se2(0.35, 0.2, 0.0)
    source, target = world.scan(world.start @ truth, 1, 0.005), world.scan(world.start, 2, 0.005)
    single, several = Open3DSymmetric(0.1), Open3DSymmetric(0.1, coarse_to_fine=[8, 4, 2, 1])
    assert off(register(single, source, target, np.eye(4)), truth)[0] > 0.1
    assert off(register(several, source, target, np.eye(4)), truth)[0] < 0.01


def test_planar_normals_keep_the_library_in_the_plane() -> None:
    """Before anything is projected back."""
    world, method = WORLDS["2d"], Open3DSymmetric(0.5)
    known = world.motions["curve"]
    source, target = (method.prepare(scan) for scan in world.pair(known, 0.01))
    T = np.asarray(method.icp(source.native, target.native, 0.5, known.guess).transformation)
    np.testing.assert_allclose(T[2], [0, 0, 1, 0], atol=1e-9)
    np.testing.assert_allclose(T[:2, 2], 0, atol=1e-9)


def test_a_turn_out_of_the_plane_is_found_in_space() -> None:
    world, truth = WORLDS["3d"], se3([0.1, -0.1, 0.05], rotation((1, -0.5, 0.2), 6))
    source, target = world.scan(world.start @ truth, 1, 0.01), world.scan(world.start, 2, 0.01)
    metres, degrees = off(register(Open3DSymmetric(1.0), source, target, np.eye(4)), truth)
    assert metres < 0.01 and degrees < 0.15
