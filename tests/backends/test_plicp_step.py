"""One step in closed form, against the geometry, the quartic and a search by brute force."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

from rbtm_bench.backends.plicp_step import (
    Matches,
    foot,
    on_the_circle,
    pseudo_inverse,
    step_to_lines,
    step_to_points,
)
from rbtm_bench.core.geometry import se2
from rbtm_bench.core.types import Array

SEEDS = range(5)


def matches_of(first: NDArray[np.int64], second: NDArray[np.int64]) -> Matches:
    """One match a source point, in order."""
    return Matches(np.arange(len(first)), first, second, np.zeros(len(first)))


def random_problem(seed: int) -> tuple[Array, Array, Matches]:
    """Source points, target points and matches that no motion satisfies."""
    random = np.random.default_rng(seed)
    moved, target = random.uniform(-4, 4, (40, 2)), random.uniform(-4, 4, (60, 2))
    first = random.integers(0, 60, 40)
    return moved, target, matches_of(first, (first + random.integers(1, 60, 40)) % 60)


def apply(pose: Array, points: Array) -> Array:
    return points @ se2(*pose)[:2, :2].T + pose[:2]


def line_cost(pose: Array, moved: Array, target: Array, matches: Matches) -> float:
    """Sum of squared distances to lines, from the definition."""
    q, along = target[matches.first], target[matches.second] - target[matches.first]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
    return float(((normal * (apply(pose, moved) - q)).sum(axis=1) ** 2).sum())


def seen_from(pose: Array, points: Array) -> Array:
    """Points (N, 2) in the frame that stands at ``pose``."""
    return (points - pose[:2]) @ se2(0, 0, pose[2])[:2, :2]


def wall(start: tuple[float, float], end: tuple[float, float], count: int) -> Array:
    return np.linspace(start, end, count)


@pytest.mark.parametrize("seed", SEEDS)
def test_no_motion_is_better_than_the_step_to_lines(seed: int) -> None:
    """The least cost of all, or the least with a turn below 90 deg."""
    moved, target, matches = random_problem(seed)
    step = step_to_lines(moved, target, matches, len(moved))
    cost = line_cost(step, moved, target, matches)
    ends = [
        minimize(line_cost, np.array([0.0, 0.0, turn]), args=(moved, target, matches), tol=1e-12)
        for turn in np.linspace(-3, 3, 7)
    ]
    near = [end.fun for end in ends if np.cos(end.x[2]) > 0.0]
    assert cost == pytest.approx(min(near or [end.fun for end in ends]), rel=1e-8)
    for change in 1e-3 * np.vstack([np.eye(3), -np.eye(3)]):
        assert line_cost(step + change, moved, target, matches) > cost


@pytest.mark.parametrize("seed", SEEDS)
def test_the_multiplier_is_the_largest_root_of_the_quartic(seed: int) -> None:
    random = np.random.default_rng(seed)
    A = random.standard_normal((5, 2))
    (a, b), (_, c) = S = A.T @ A
    h = random.standard_normal(2) * 10.0 ** random.integers(-3, 4)
    y = np.array(on_the_circle((a, b, c), (h[0], h[1])))
    # |adj(S + l I) h|^2 = det(S + l I)^2, expanded by numpy's polynomials in l
    line, determinant = np.poly1d([1.0, 0.0]), np.poly1d([1.0, a + c, a * c - b * b])
    adjoint = [(line + c) * h[0] - b * h[1], (line + a) * h[1] - b * h[0]]
    roots = (determinant * determinant - adjoint[0] * adjoint[0] - adjoint[1] * adjoint[1]).roots
    largest = roots[np.abs(roots.imag) < 1e-6 * np.abs(roots).max()].real.max()
    np.testing.assert_allclose(y, np.linalg.solve(S + largest * np.eye(2), h), atol=1e-6)
    turns = np.linspace(-np.pi, np.pi, 10001)
    circle = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    values = np.einsum("ni,ij,nj->n", circle, S, circle) - 2 * circle @ h
    assert y @ S @ y - 2 * y @ h <= values.min() + 1e-12
    assert np.hypot(*y) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("pose", [(0.1, -0.2, 0.05), (-1.0, 2.0, 2.8), (0.0, 0.0, -1.5)])
def test_exact_lines_are_met_in_one_step_however_far(pose: tuple[float, float, float]) -> None:
    walls = [wall((0, 0), (4, 0), 9), wall((4, 0.5), (4, 3), 6), wall((3, 4), (0, 3), 5)]
    room, place = np.concatenate(walls), np.array([0, 3, 5, 9, 11, 13, 15, 17])
    truth = np.array(pose)
    moved = seen_from(truth, room[place])
    step = step_to_lines(moved, room, matches_of(place, place + 1), len(place))
    np.testing.assert_allclose(step, truth, atol=1e-9)


@pytest.mark.parametrize("noise", [0.0, 1e-12, 0.01])
@pytest.mark.parametrize("seed", SEEDS)
def test_two_walls_are_met_with_the_smaller_turn(seed: int, noise: float) -> None:
    """Half a turn more would meet the two lines just as well."""
    corner = np.concatenate([wall((0, 0), (4, 0), 9), wall((4, 0.5), (4, 3), 6)])
    place = np.arange(14)
    place = place[place != 8]
    truth = np.array([0.1, -0.2, 0.3])
    moved = seen_from(truth, corner[place])
    moved += noise * np.random.default_rng(seed).standard_normal(moved.shape)
    step = step_to_lines(moved, corner, matches_of(place, place + 1), len(place))
    np.testing.assert_allclose(step, truth, atol=1e-8 + 5 * noise)
    turned = np.array([8.0, 0.0, np.pi]) + np.array([-1, -1, 1]) * step  # about the corner
    costs = [line_cost(T, moved, corner, matches_of(place, place + 1)) for T in (step, turned)]
    assert costs[0] == pytest.approx(costs[1], rel=1e-6, abs=1e-12)


def test_points_move_along_a_line_freely() -> None:
    """One wall: the step goes straight to it, and nothing along it."""
    target = wall((0, 0), (4, 0), 5)
    moved = np.array([[0.3, 0.2], [1.4, 0.2], [3.1, 0.2]])
    matches = matches_of(np.array([0, 1, 3]), np.array([1, 2, 4]))
    np.testing.assert_allclose(step_to_lines(moved, target, matches, 3), [0, -0.2, 0], atol=1e-12)


def test_a_turn_that_nothing_holds_is_none() -> None:
    """Lines round a circle, seen from its centre, hold the place only."""
    turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    target = 2 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    first, second = np.arange(12), (np.arange(12) + 1) % 12
    middles = 0.5 * (target[first] + target[second])
    moved = middles + np.array([0.05, -0.02])
    step = step_to_lines(moved, target, matches_of(first, second), 12)
    np.testing.assert_allclose(step, [-0.05, 0.02, 0], atol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_step_to_points_is_procrustes(seed: int) -> None:
    moved, target, matches = random_problem(seed)
    feet = np.array(
        [foot(*moved[i], target, matches.first[i], matches.second[i]) for i in range(len(moved))]
    )
    step = step_to_points(moved, target, matches, len(moved))
    centred, aim = moved - moved.mean(axis=0), feet - feet.mean(axis=0)
    U, _, Vt = np.linalg.svd(centred.T @ aim)
    R = Vt.T @ np.diag([1.0, np.linalg.det(Vt.T @ U.T)]) @ U.T
    np.testing.assert_allclose(se2(*step)[:2, :2], R, atol=1e-12)
    expected = feet.mean(axis=0) - R @ moved.mean(axis=0)
    np.testing.assert_allclose(step[:2], expected, atol=1e-12)


def test_the_foot_stays_on_the_segment() -> None:
    target = np.array([[1.0, 1.0], [3.0, 1.0]])
    assert foot(2.5, 4.0, target, 0, 1) == (2.5, 1.0)
    assert foot(0.0, 0.0, target, 0, 1) == (1.0, 1.0)
    assert foot(9.0, 2.0, target, 0, 1) == (3.0, 1.0)


def test_the_pseudo_inverse_leaves_out_what_is_flat() -> None:
    np.testing.assert_allclose(pseudo_inverse(4.0, 0.0, 0.0), [0.25, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(pseudo_inverse(1.0, 1.0, 1.0), [0.25, 0.25, 0.25], atol=1e-15)
    M = np.array([[3.0, 1.0], [1.0, 2.0]])
    (a, b), (_, c) = np.linalg.inv(M)
    np.testing.assert_allclose(pseudo_inverse(3.0, 1.0, 2.0), [a, b, c], atol=1e-15)
