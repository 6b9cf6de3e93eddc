"""What a backend must not do: guess silently, modify its scans, or change its mind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rbtm_bench.backends.base import Backend, Prepared
from rbtm_bench.contract.scene import World, rotation
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import inverse, se2, se3, translation_norm
from rbtm_bench.core.types import Array, RegistrationResult, Scan
from rbtm_bench.odometry import judge

GROUP = "backend"
MOTIONS = ("forward", "turn", "curve")
AXIS = [0.0, 0.0, 1.0, 0.0]


@pytest.fixture(scope="module")
def scans(world: World) -> list[Scan]:
    """A target, and three sources that moved."""
    moved = [world.motions[name].T_target_source for name in MOTIONS]
    return [
        world.scan(world.start, 0, 0.005),
        *(world.scan(world.start @ T, i, 0.005) for i, T in enumerate(moved, start=1)),
    ]


@pytest.fixture(scope="module")
def guess(world: World) -> Array:
    """A guess that is not the identity, and not the truth."""
    if world.name == "2d":
        return se2(0.02, -0.03, 0.01)
    return se3([0.02, -0.03, 0.01], rotation((0, 1, 1), 0.5))


def bits(results: list[RegistrationResult]) -> list[tuple[bytes, float, float, int]]:
    """What must repeat exactly."""
    return [
        (r.T_target_source.tobytes(), r.fitness, np.nan_to_num(r.inlier_rmse), r.inliers)
        for r in results
    ]


def test_scans_and_prepared_scans_are_not_modified(
    backend: Backend, scans: list[Scan], guess: Array
) -> None:
    kept = [replace(scan, points=scan.points.copy()) for scan in scans[:2]]
    before = [scan.points.tobytes() for scan in kept]
    prepared = [backend.prepare(scan) for scan in kept]
    points = [p.points.tobytes() for p in prepared]
    for _ in range(2):
        judge.register(backend, prepared[1], prepared[0], guess)
    backend.merge([(p, guess) for p in prepared])
    assert [s.points.tobytes() for s in kept] == before, "the scan's own points were modified"
    assert [p.points.tobytes() for p in prepared] == points, (
        "a prepared scan's points were modified: it is used for many registrations"
    )


def test_repeated_registrations_give_the_same_bits(
    backend: Backend, scans: list[Scan], guess: Array
) -> None:
    source, target = backend.prepare(scans[3]), backend.prepare(scans[0])
    results = bits([judge.register(backend, source, target, guess) for _ in range(5)])
    fresh = bits(
        [judge.register(backend, backend.prepare(scans[3]), backend.prepare(scans[0]), guess)]
    )
    assert len(set(results)) == 1, (
        "five registrations of one pair differ: is there unseeded chance, or more than one thread?"
    )
    assert fresh == results[:1], "preparing the same scans again gives another registration"


def test_the_order_of_registrations_does_not_matter(
    backend: Backend, scans: list[Scan], guess: Array
) -> None:
    prepared = [backend.prepare(scan) for scan in scans]
    pairs = [(1, 0), (2, 0), (3, 1), (0, 2), (3, 0)]
    first = [judge.register(backend, prepared[s], prepared[t], guess) for s, t in pairs]
    second = [judge.register(backend, prepared[s], prepared[t], guess) for s, t in pairs[::-1]]
    assert bits(first) == bits(second)[::-1], (
        "a registration depends on those before it: keep no state between calls of register()"
    )


def bad_clouds(good: Array) -> dict[str, Array]:
    """Points that nothing can be registered with."""
    unknown, infinite = good.copy(), good.copy()
    unknown[7, 1], infinite[3, 0] = np.nan, np.inf
    return {"none": good[:0], "one": good[:1], "not a number": unknown, "infinite": infinite}


def test_what_the_base_class_guarantees_is_not_replaced(
    backend: Backend, scans: list[Scan]
) -> None:
    """Checked input, the plane, no silent guess, symmetric information: tests/backends/test_base.py
    holds the base class to them, and so every plug-in that leaves ``register`` alone."""
    name = type(backend).__name__
    own = type(backend).register is not Backend.register or "register" in vars(backend)
    assert not own, (
        f"{name} replaces register(), and with it what every backend guarantees: write align()"
    )
    prepared = backend.prepare(scans[0])
    clouds = {"prepare": prepared, "merge": backend.merge([(prepared, np.eye(4))])}
    for method, cloud in clouds.items():
        assert isinstance(cloud, Prepared), f"{name}.{method}() returns {type(cloud).__name__}"
        points = cloud.points
        sound = points.ndim == 2 and points.shape[1] == 3 and points.dtype == np.float64
        assert sound and np.isfinite(points).all(), (
            f"{name}.{method}() gives {points.dtype} points of shape {points.shape}: expected "
            "finite float64, (N, 3)"
        )
        assert cloud.planar is scans[0].planar, f"{method}() lost whether the scan is planar"
        if scans[0].planar:
            assert not points[:, 2].any(), f"{method}() moved planar points out of z = 0"
    if type(backend).prepare is not Backend.prepare:
        for what, bad in bad_clouds(scans[0].points).items():
            scan = replace(scans[0], points=bad, ranges=None, angles=None)
            with pytest.raises(BackendError):
                backend.prepare(scan)
                pytest.fail(f"{name}.prepare() takes a scan of points that are {what}")


@pytest.mark.parametrize("side", ["source", "target"])
def test_never_a_silent_guess(backend: Backend, scans: list[Scan], guess: Array, side: str) -> None:
    """Scans of two places raise BackendError or give converged = False; the guess is no answer."""
    good = scans[0]
    off = np.array([1000.0, -500.0, 0.0])
    far = replace(good, points=good.points + off, ranges=None, angles=None)
    source, target = (far, good) if side == "source" else (good, far)
    try:
        result = judge.register(backend, backend.prepare(source), backend.prepare(target), guess)
    except BackendError:
        return
    except Exception as error:
        pytest.fail(f"{side}: {type(error).__name__} ({error}): raise BackendError instead")
    truth = se3(-off if side == "source" else off, np.eye(3))
    error_m = float(translation_norm(inverse(truth) @ result.T_target_source))
    if not backend.uses_guess and error_m < 0.05:
        return  # a global method may well bring together scans that lie far apart
    moved = float(translation_norm(inverse(guess) @ result.T_target_source))
    assert result.converged is False, (
        f"{side} 1 km away: converged is {result.converged} and the result is {moved:.3f} m from "
        "the guess: expected BackendError or converged = False"
    )
