"""Every backend finds known motions, in the right direction, in the plane and in space."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.backends.base import Backend
from rbtm_bench.contract.scene import World
from rbtm_bench.core.geometry import inverse, rotation_angle, transform, translation_norm
from rbtm_bench.core.types import Array, RegistrationResult, Scan
from rbtm_bench.odometry import judge
from rbtm_bench.odometry.judge import evaluate

GROUP = "backend"
NOISE = (0.0, 0.010)
MOTIONS = ("still", "forward", "left", "turn", "curve", "from_far_guess")


def register(
    backend: Backend, source: Scan, target: Scan, guess: Array | None = None
) -> RegistrationResult:
    """Prepare both scans and register them, from no motion unless a guess is given."""
    prepared, model = backend.prepare(source), backend.prepare(target)
    return judge.register(backend, prepared, model, np.eye(4) if guess is None else guess)


def assert_near(T: Array, truth: Array, world: World, what: str) -> None:
    """Both motions agree within the world's tolerance."""
    error = inverse(truth) @ T
    metres, degrees = float(translation_norm(error)), float(np.degrees(rotation_angle(error)))
    is_near = metres <= world.tolerance_m and degrees <= world.tolerance_deg
    assert is_near, (
        f"{what}: {metres:.3f} m and {degrees:.2f} deg from the truth, expected at most "
        f"{world.tolerance_m:g} m and {world.tolerance_deg:g} deg\nfound\n{T}\ntruth\n{truth}"
    )


@pytest.mark.parametrize("noise", NOISE, ids=["exact", "noisy"])
@pytest.mark.parametrize("motion", MOTIONS)
def test_known_motions_are_found(
    registers: Backend, world: World, motion: str, noise: float
) -> None:
    known = world.motions[motion]
    source, target = world.pair(known, noise)
    result = register(registers, source, target, known.guess)
    assert result.converged is not False, (
        "converged is False for a registration that is right: set it only where the method failed"
    )
    assert_near(result.T_target_source, known.T_target_source, world, f"{motion}, {noise:g} m")


def test_the_result_maps_source_points_into_the_target_frame(
    registers: Backend, world: World
) -> None:
    known = world.motions["curve"]
    source, target = world.pair(known)
    prepared, model = registers.prepare(source), registers.prepare(target)
    T = judge.register(registers, prepared, model, np.eye(4)).T_target_source
    radius = 0.1 if world.name == "3d" else 0.05
    fitness, wrong, truth = (
        evaluate(prepared, model, motion, radius)[0]
        for motion in (T, inverse(T), known.T_target_source)
    )
    assert fitness > wrong, (
        f"the inverse of T_target_source fits better ({wrong:.2f} of the points) than "
        f"T_target_source itself ({fitness:.2f}): is it T_source_target?"
    )
    assert fitness >= 0.8 * truth, (
        f"after T_target_source {fitness:.2f} of the source points lie within {radius} m of the "
        f"target, after the true motion {truth:.2f}"
    )


def test_the_guess_is_where_the_search_starts(registers: Backend, world: World) -> None:
    known = world.motions["from_far_guess"]
    source, target = world.pair(known)
    right = register(registers, source, target, known.guess).T_target_source
    assert_near(right, known.T_target_source, world, "from a guess near the truth")
    if not registers.uses_guess:
        return
    # the very same scans, with the target moved far away: only the guess tells
    moved = world.motions["turn"].T_target_source @ known.T_target_source
    shifted = transform(world.motions["turn"].T_target_source, target.points)
    far = Scan(target.index, target.stamp, shifted, target.planar)
    guess = world.motions["turn"].T_target_source @ known.guess
    result = register(registers, source, far, guess)
    assert_near(result.T_target_source, moved, world, "with target and guess moved alike")


@pytest.mark.parametrize("motion", ["forward", "curve"])
def test_forward_and_inverse_agree(registers: Backend, world: World, motion: str) -> None:
    source, target = world.pair(world.motions[motion], 0.005)
    forward = register(registers, source, target).T_target_source
    back = register(registers, target, source).T_target_source
    assert_near(forward @ back, np.eye(4), world, "register(a, b) @ register(b, a)")


def test_identical_clouds_stay_where_they_are(backend: Backend, world: World) -> None:
    _, target = world.pair(world.motions["still"], 0.005)
    result = register(backend, target, target)
    off = float(np.abs(result.T_target_source - np.eye(4)).max())
    most = backend.self_tolerance
    assert most <= 0.02, f"self_tolerance = {most:g}: more than 0.02 m or rad is no registration"
    assert off <= most, f"a scan registered to itself moves by {off:.2e}: expected at most {most:g}"
    assert result.fitness == 1.0, f"a scan registered to itself has fitness {result.fitness}, not 1"
    assert result.inlier_rmse <= 5 * most, (
        f"a scan registered to itself has an inlier RMSE of {result.inlier_rmse:.2e} m, not 0"
    )


def test_merged_scans_are_a_target(backend: Backend, world: World) -> None:
    curve, forward = world.motions["curve"], world.motions["forward"].T_target_source
    source, target = world.pair(curve, 0.005)
    neighbour = world.scan(world.start @ forward, 3, 0.005)
    parts = [(backend.prepare(target), np.eye(4)), (backend.prepare(neighbour), forward)]
    merged = backend.merge(parts)
    most = sum(len(part.points) for part, _ in parts)
    assert merged.planar == target.planar, "merge() lost whether its parts are planar"
    assert 0 < len(merged.points) <= most, (
        f"merge() of {most} points gave {len(merged.points)}: expected no more than its parts have"
    )
    result = judge.register(backend, backend.prepare(source), merged, np.eye(4))
    if not backend.is_baseline:
        truth = curve.T_target_source
        assert_near(result.T_target_source, truth, world, "registered to a merged target")
