"""Localizability by hand, and keeping the guess where a scan cannot see."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rbtm_bench.backends.base import Prepared
from rbtm_bench.core.columns import DEGENERATE
from rbtm_bench.core.geometry import inverse, is_rigid, se2, se3
from rbtm_bench.core.types import Array, Localizability, RegistrationResult
from rbtm_bench.odometry.degeneracy import fused, remap, unseen
from rbtm_bench.odometry.judge import evaluate
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.runs.settings import compose_settings

STEPS = np.arange(-2.0, 2.01, 0.05)
ZERO = np.zeros(len(STEPS))
WALL_BELOW = np.column_stack([STEPS, ZERO - 1.0, ZERO])  # y = -1: its normal is y
WALL_RIGHT = np.column_stack([ZERO + 2.0, STEPS, ZERO])  # x = 2: its normal is x
CORRIDOR = np.concatenate([WALL_BELOW, WALL_BELOW + np.array([0.0, 2.0, 0.0])])


def held(points: Array, T: Array | None = None, planar: bool = True) -> Localizability:
    """The localizability of points registered to themselves moved by T."""
    T = np.eye(4) if T is None else T
    source = Prepared(points, planar, None)
    target = Prepared(points @ T[:3, :3].T + T[:3, 3], planar, None)
    found = evaluate(source, target, T, 0.21).localizability
    assert found is not None
    return found


def result(T: Array, matrix: Array, lever: float = 2.0) -> RegistrationResult:
    return RegistrationResult(
        T, None, 1.0, 0.0, 100, localizability=Localizability(matrix, lever)
    )  # fmt: skip


def test_a_wall_by_hand() -> None:
    """All normals are y, so j = (0, +-1, +-x / lever): x is free, y seen by every point."""
    matrix = held(WALL_BELOW).matrix
    lever = float(np.sqrt((STEPS**2 + 1.0).mean()))
    assert held(WALL_BELOW).lever == pytest.approx(lever)
    assert matrix[0, 0] == pytest.approx(0.0, abs=1e-12)
    assert matrix[1, 1] == pytest.approx(1.0)
    assert matrix[2, 2] == pytest.approx((STEPS**2).mean() / lever**2)


def test_a_bare_corridor_cannot_see_its_axis_and_an_end_wall_mends_it() -> None:
    values, vectors = held(CORRIDOR).axes
    assert values[0] < 1e-9 < DEGENERATE < values[1]
    assert abs(vectors[0, 0]) == pytest.approx(1.0)
    closed = held(np.concatenate([CORRIDOR, WALL_RIGHT]))
    assert closed.axes[0][0] > 10 * DEGENERATE


@pytest.mark.parametrize("T", [se2(0.3, -0.2, 0.5), se2(5.0, 1.0, 3.0)])
def test_the_weak_direction_is_in_the_scan_s_own_frame(T: Array) -> None:
    still, moved = held(CORRIDOR), held(CORRIDOR, T)
    np.testing.assert_allclose(moved.matrix, still.matrix, atol=1e-9)


@given(st.floats(0.1, 50.0))
def test_scale_does_not_matter(scale: float) -> None:
    room = np.concatenate([CORRIDOR, WALL_RIGHT])
    small = Prepared(scale * room, True, None)
    found = evaluate(small, small, np.eye(4), 0.21 * scale).localizability
    assert found is not None
    np.testing.assert_allclose(found.matrix, held(room).matrix, atol=1e-9)


def test_a_tunnel_in_space_cannot_see_its_axis() -> None:
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    ring = np.column_stack([np.zeros(60), 1.5 * np.cos(angle), np.sin(angle)])
    tunnel = np.concatenate([ring + np.array([x, 0, 0]) for x in np.arange(-2, 2.01, 0.1)])
    values, vectors = held(tunnel, se3([0.1, 0.2, 0.3], np.eye(3)), planar=False).axes
    assert values.shape == (6,) and values[0] < DEGENERATE < values[1]
    assert abs(vectors[0, 0]) > 0.99


def test_points_apart_have_no_surface() -> None:
    far = Prepared(10.0 * WALL_BELOW, True, None)
    assert evaluate(far, far, np.eye(4), 0.21).localizability is None


def test_remapping_keeps_the_guess_along_the_unseen_axis_only() -> None:
    guess, found = se2(1.0, 0.1, 0.02), se2(0.4, 0.3, 0.05)
    T = remap(result(found, np.diag([1e-4, 0.9, 0.5])), guess, DEGENERATE).T_target_source
    moved = inverse(guess) @ T
    expected = inverse(guess) @ found
    assert moved[0, 3] == pytest.approx(0.0, abs=1e-12)
    assert moved[1, 3] == pytest.approx(expected[1, 3])
    assert np.arctan2(T[1, 0], T[0, 0]) == pytest.approx(0.05)


def test_remapping_by_hand_with_a_mixed_axis() -> None:
    """Unseen: (1, 0, 1)/sqrt(2), that is x with rotation; lever 2 turns 0.1 rad into 0.2 m."""
    axis = np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0)
    matrix = 0.5 * (np.eye(3) - np.outer(axis, axis))
    T = remap(result(se2(0.4, 0.1, 0.1), matrix), np.eye(4), DEGENERATE).T_target_source
    # (0.4, 0.1, 0.2) less its part 0.3 along (1, 0, 1): (0.1, 0.1, -0.1), and -0.1 m is -0.05 rad
    np.testing.assert_allclose(T, se2(0.1, 0.1, -0.05), atol=1e-12)


def test_a_motion_that_is_seen_everywhere_stays_bit_for_bit() -> None:
    good = result(se2(0.4, 0.3, 0.05), np.diag([0.2, 0.9, 0.5]))
    assert remap(good, np.eye(4), DEGENERATE) is good
    unknown = RegistrationResult(np.eye(4), None, 0.0, np.nan, 0)
    assert remap(unknown, np.eye(4), DEGENERATE) is unknown
    assert (unseen(good, DEGENERATE), unseen(good, 0.3), unseen(unknown, 0.3)) == (0, 1, 0)


def test_what_is_held_just_as_much_as_asked_is_seen() -> None:
    """Of 0.125, 0.25 and 0.5 at a threshold of 0.25: x alone is the guess's."""
    found = result(se2(0.4, 0.3, 0.0), np.diag([0.125, 0.25, 0.5]))
    assert unseen(found, 0.25) == 1
    T = remap(found, np.eye(4), 0.25).T_target_source
    np.testing.assert_allclose(T, se2(0.0, 0.3, 0.0), atol=1e-12)


@given(st.lists(st.floats(0, 1), min_size=6, max_size=6), st.integers(0, 2**32 - 1))
def test_remapping_in_space_gives_a_motion(values: list[float], seed: int) -> None:
    random = np.random.default_rng(seed)
    Q = np.linalg.qr(random.normal(size=(6, 6)))[0]
    T = se3(random.normal(size=3), np.linalg.qr(random.normal(size=(3, 3)))[0])
    T[:3, :3] *= np.sign(np.linalg.det(T[:3, :3]))
    out = remap(result(T, Q @ np.diag(values) @ Q.T), np.eye(4), 0.5).T_target_source
    assert is_rigid(out)
    if not any(v < 0.5 - 1e-9 for v in values) and not any(abs(v - 0.5) < 1e-9 for v in values):
        np.testing.assert_array_equal(out, T)
    if all(v < 0.5 - 1e-9 for v in values):
        np.testing.assert_allclose(out, np.eye(4), atol=1e-12)


def run(*words: str):  # type: ignore[no-untyped-def]
    from rbtm_bench.runs import assembly

    parts = assembly.instantiate(compose_settings(list(words)))
    return [step.record for step in odometry(parts.dataset, parts.method)]


def test_the_corridor_s_steps_say_what_they_see() -> None:
    words = ("dataset.scans=12", "guess=odometry", "selector=previous")
    bare = run(*words, "dataset.environment=bare")[1:]
    paper = run(*words, "dataset.environment=paper")[1:]
    assert all(r.localizability_min < DEGENERATE for r in bare)
    assert all(r.localizability_min > 5 * DEGENERATE for r in paper)
    assert all(abs(r.weak_direction[0]) > 0.99 for r in bare)
    assert all(len(r.localizability) == 3 and r.kept_guess is None for r in bare)


def test_the_setting_keeps_odometry_along_a_bare_corridor() -> None:
    words = ("dataset.scans=12", "guess=odometry", "selector=previous", "dataset.environment=bare")
    kept = run(*words, "guess_along_degenerate=0.01")[1:]
    assert [r.kept_guess for r in kept] == [1] * 11
    assert all(r.kept_guess == 0 for r in run(*words[:3], "guess_along_degenerate=0.01")[1:])


# --- the guess as a weak prior


def test_fusing_by_hand() -> None:
    # off along x by 0.3 m: measured 100 / (10 * 0.03^2) * 0.5, the guess w / 0.01^2 (no motion)
    measured, prior = 0.5 * 100 / (10 * 0.03**2), 0.01 / 0.01**2
    one = fused(result(se2(0.3, 0.0, 0.0), np.diag([0.5, 0.5, 0.4])), np.eye(4), 0.01)
    expected = se2(0.3 * measured / (measured + prior), 0.0, 0.0)
    np.testing.assert_allclose(one.T_target_source, expected, atol=1e-12)


def test_fusing_leaves_what_is_seen_and_keeps_the_guess_where_nothing_is() -> None:
    guess = se2(1.0, -0.5, 0.2)
    blind = result(guess @ se2(0.4, 0.01, 0.02), np.diag([0.0, 0.5, 0.4]))
    off = inverse(guess) @ fused(blind, guess, 0.01).T_target_source
    assert abs(off[0, 3]) < 1e-4 and off[1, 3] == pytest.approx(0.01, rel=0.01)
    assert off[1, 0] == pytest.approx(0.02, rel=0.02)
    trusted = fused(blind, guess, 1e9).T_target_source
    np.testing.assert_allclose(trusted, guess, atol=1e-6)
    bare = RegistrationResult(guess, None, 1.0, 0.0, 100)
    assert fused(bare, np.eye(4), 0.1) is bare


def test_fusing_in_space() -> None:
    moved = np.eye(4)
    moved[:3, 3] = [0.2, 0.1, 0.05]
    tunnel = result(moved, np.diag([0.0, 0.4, 0.4, 0.3, 0.2, 0.2]))
    T = fused(tunnel, np.eye(4), 0.01).T_target_source
    assert is_rigid(T) and T[0, 3] == 0.0
    assert T[1, 3] == pytest.approx(0.1, rel=0.05) and T[2, 3] == pytest.approx(0.05, rel=0.05)


def test_remapping_in_space_by_hand() -> None:
    """Unseen: x with roll, (1, 0, 0, 1, 0, 0)/sqrt(2); lever 2 turns 0.1 rad into 0.2 m. The guess
    lies anywhere: what counts is the motion from it, in the scan's own frame."""
    axis = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 0.0]) / np.sqrt(2.0)
    guess = se3(np.array([5.0, -2.0, 1.0]), se2(0, 0, 1.2)[:3, :3])

    def rolled(x: float, y: float, roll: float) -> Array:
        c, s = np.cos(roll), np.sin(roll)
        return se3(np.array([x, y, 0.0]), np.array([[1, 0, 0], [0, c, -s], [0, s, c]]))

    matrix = 0.5 * (np.eye(6) - np.outer(axis, axis))
    given = result(guess @ rolled(0.4, 0.1, 0.1), matrix)
    T = remap(given, guess, DEGENERATE).T_target_source
    # (0.4, 0.2) m less its part 0.3 along (1, 1): 0.1 m of x, and -0.1 m of roll is -0.05 rad
    np.testing.assert_allclose(inverse(guess) @ T, rolled(0.1, 0.1, -0.05), atol=1e-12)


@pytest.mark.slow
def test_the_setting_keeps_odometry_along_a_tunnel_in_space() -> None:
    from rbtm_bench.runs import assembly

    words = ["dataset=simulated", "dataset.place=tunnel", "dataset.scans=25", "guess=odometry"]
    words += ["backend=open3d_p2plane", "selector=previous"]

    def short_by(*more: str) -> float:
        parts = assembly.instantiate(compose_settings([*words, *more]))
        scans = list(parts.dataset)
        last = [step.T_world_scan for step in odometry(iter(scans), parts.method)][-1]
        truth = inverse(scans[0].ground_truth) @ scans[-1].ground_truth
        return abs(float((inverse(truth) @ last)[0, 3]))

    assert short_by("guess_along_degenerate=0.1") < 0.2 * short_by()
