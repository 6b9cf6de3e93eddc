"""The common evaluator by hand, and what ``Backend.register`` makes of a library's answer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rbtm_bench.backends.base import Alignment, Backend, Prepared
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import se2, se3
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.odometry import judge
from rbtm_bench.odometry.judge import evaluate

LINE = np.column_stack([np.arange(10.0), np.zeros(10), np.zeros(10)])


def prepared(points: Any, planar: bool = False) -> Prepared:
    """Points as they are."""
    return Prepared(np.array(points, dtype=float), planar, None)


class Fixed(Backend):
    """Answers what it is told to."""

    def __init__(self, answer: Alignment | Exception, radius: float = 0.3) -> None:
        super().__init__(radius)
        self.answer = answer

    def build(self, points: Array, planar: bool) -> None:
        return None

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


def test_fitness_rmse_and_inliers_by_hand() -> None:
    source = prepared([[0, 0, 0], [1, 0.1, 0], [2, 0, 0.2], [3, 0.5, 0], [50, 0, 0]])
    fitness, rmse, inliers, _ = evaluate(source, prepared(LINE), np.eye(4), 0.3)
    assert fitness == pytest.approx(3 / 5)
    assert rmse == pytest.approx(np.sqrt((0.0 + 0.01 + 0.04) / 3))
    assert inliers == 3


def test_localizability_in_space_is_symmetric_to_the_last_bit() -> None:
    walls = np.random.default_rng(0).uniform(0.0, 2.0, (600, 3))
    walls[np.arange(600), np.arange(600) % 3] = 0.0
    held = evaluate(prepared(walls), prepared(walls), se2(0.01, 0.02, 0.1), 0.3).localizability
    assert held is not None and held.matrix.shape == (6, 6)
    np.testing.assert_array_equal(held.matrix, held.matrix.T)


def test_the_radius_itself_is_outside() -> None:
    source = prepared([[0, 0.5, 0], [1, 0.499, 0]])
    assert evaluate(source, prepared(LINE), np.eye(4), 0.5)[2] == 1


def test_several_source_points_may_share_a_target_point() -> None:
    source = prepared([[0, 0.1, 0]] * 4)
    fitness, rmse, inliers, _ = evaluate(source, prepared(LINE), np.eye(4), 0.3)
    assert (fitness, inliers) == (1.0, 4)
    assert rmse == pytest.approx(0.1)


def test_the_motion_maps_source_to_target() -> None:
    source = prepared(LINE - [0.0, 2.0, 0.0])
    assert evaluate(source, prepared(LINE), se2(0, 2, 0), 0.1)[0] == 1.0
    assert evaluate(source, prepared(LINE), se2(0, -2, 0), 0.1)[0] == 0.0


def test_no_inliers_have_no_rmse() -> None:
    fitness, rmse, inliers, _ = evaluate(prepared(LINE + 50), prepared(LINE), np.eye(4), 0.3)
    assert (fitness, inliers) == (0.0, 0)
    assert np.isnan(rmse)


@pytest.mark.parametrize(("within", "converged"), [(0, False), (2, False), (3, True), (6, True)])
def test_too_few_inliers_are_never_converged(within: int, converged: bool) -> None:
    points = LINE[:6] + np.where(np.arange(6) < within, 0.0, 50.0)[:, None] * [0, 1, 0]
    backend = Fixed(Alignment(np.eye(4), converged=True))
    result = judge.register(backend, prepared(points), prepared(LINE), np.eye(4))
    assert result.inliers == within
    assert result.converged is converged


@pytest.mark.parametrize("said", [True, False])
def test_converged_is_python_s_own_bool(said: bool) -> None:
    numpy_s: Any = np.bool_(said)
    backend = Fixed(Alignment(np.eye(4), converged=numpy_s))
    assert judge.register(backend, prepared(LINE), prepared(LINE), np.eye(4)).converged is said


def test_a_library_s_own_words_are_kept_beside() -> None:
    said = Alignment(np.eye(4), None, 7, np.eye(6), 0.25, 0.5)
    result = judge.register(Fixed(said), prepared(LINE), prepared(LINE), np.eye(4))
    assert (result.library_fitness, result.library_rmse, result.iterations) == (0.25, 0.5, 7)
    assert (result.fitness, result.inlier_rmse) == (1.0, 0.0)
    assert result.converged is None
    np.testing.assert_array_equal(result.information, np.eye(6))


def test_what_a_library_raises_becomes_a_backend_error() -> None:
    with pytest.raises(BackendError, match="Fixed: ValueError: singular"):
        judge.register(Fixed(ValueError("singular")), prepared(LINE), prepared(LINE), np.eye(4))


@pytest.mark.parametrize("answer", [np.full((4, 4), np.nan), 2 * np.eye(4), np.eye(3)])
def test_an_answer_that_is_no_motion_is_an_error(answer: Array) -> None:
    with pytest.raises(BackendError, match="no rigid motion"):
        judge.register(Fixed(Alignment(answer)), prepared(LINE), prepared(LINE), np.eye(4))


def test_planar_answers_are_put_into_the_plane() -> None:
    tilt = se3(
        [1, 2, 0.1], [[1, 0, 0], [0, np.cos(0.1), -np.sin(0.1)], [0, np.sin(0.1), np.cos(0.1)]]
    )
    both = judge.register(
        Fixed(Alignment(tilt)), prepared(LINE, planar=True), prepared(LINE, planar=True), np.eye(4)
    )
    np.testing.assert_allclose(both.T_target_source, se2(1, 2, 0), atol=1e-15)
    space = judge.register(Fixed(Alignment(tilt)), prepared(LINE), prepared(LINE), np.eye(4))
    np.testing.assert_array_equal(space.T_target_source, tilt)


@pytest.mark.parametrize("shape", [(6, 2), (18,), (2, 3, 3)])
def test_points_of_another_shape_are_an_error(shape: tuple[int, ...]) -> None:
    with pytest.raises(BackendError, match=r"scan 4: points .* expected"):
        Fixed(Alignment(np.eye(4))).prepare(Scan(4, 0.0, np.zeros(shape)))
