"""What ``Backend`` guarantees for every plug-in that writes ``build`` and ``align`` alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from loop_helpers import Perfect, drive, method

from rbtm_bench.backends.base import Alignment, Backend, Prepared
from rbtm_bench.contract.scene import WORLDS, World, rotation
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import se2, se3, transform
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.odometry import judge
from rbtm_bench.odometry.loop import odometry

AXIS = [0.0, 0.0, 1.0, 0.0]


class Answering(Backend):
    """Answers with what it is given, or a little beside the guess."""

    def __init__(self, answer: Any = None, radius: float = 0.3) -> None:
        super().__init__(radius)
        self.answer = answer

    def build(self, points: Array, planar: bool) -> None:
        return None

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Any:
        if isinstance(self.answer, BaseException):
            raise self.answer
        if self.answer is not None:
            return self.answer
        step = se3([0.01, 0.0, 0.002], rotation((1, 0, 0), 0.3))
        T_target_source[:] = T_target_source @ step  # a plug-in may spoil its own copy
        information = np.arange(36.0).reshape(6, 6)
        return Alignment(T_target_source, np.True_, 3, information, 0.5, 0.1)


@pytest.fixture(params=list(WORLDS.values()), ids=list(WORLDS))
def world(request: pytest.FixtureRequest) -> World:
    return request.param


@pytest.fixture
def scans(world: World) -> list[Scan]:
    T = world.motions["forward"].T_target_source
    return [world.scan(world.start, 0, 0.005), world.scan(world.start @ T, 1, 0.005)]


@pytest.fixture
def pair(scans: list[Scan]) -> tuple[Prepared, Prepared]:
    backend = Answering()
    return backend.prepare(scans[1]), backend.prepare(scans[0])


def test_a_result_is_well_formed(pair: tuple[Prepared, Prepared]) -> None:
    guess = se2(0.02, -0.03, 0.01)
    given = guess.copy()
    alignment = Answering().register(*pair, given)
    assert given.tobytes() == guess.tobytes()
    assert not np.shares_memory(alignment.T_target_source, given)
    assert alignment.T_target_source.dtype == np.float64
    assert alignment.converged is True and alignment.seconds >= 0.0
    assert (alignment.library_fitness, alignment.library_rmse) == (0.5, 0.1)
    information = alignment.information
    np.testing.assert_array_equal(information, information.T)
    if pair[0].planar:
        assert not information[[2, 3, 4]].any() and not information[:, [2, 3, 4]].any()
        assert information[0, 5] == (5 + 30) / 2
    else:
        assert information[2, 3] == (15 + 20) / 2


def test_planar_results_stay_in_the_plane_exactly(pair: tuple[Prepared, Prepared]) -> None:
    T = Answering().register(*pair, np.eye(4)).T_target_source
    assert (T[2].tolist() == AXIS and T[:, 2].tolist() == AXIS) is pair[0].planar


def test_fitness_and_rmse_by_brute_force(pair: tuple[Prepared, Prepared]) -> None:
    source, target = pair
    result = judge.register(Answering(radius=0.05), source, target, np.eye(4))
    moved = transform(result.T_target_source, source.points)
    nearest = np.array([np.sqrt(((target.points - p) ** 2).sum(axis=1).min()) for p in moved])
    inlier = nearest[nearest < 0.05]
    assert 0 < len(inlier) < len(nearest)
    assert result.inliers == len(inlier)
    assert result.fitness == pytest.approx(len(inlier) / len(nearest), abs=1e-12)
    assert result.inlier_rmse == pytest.approx(np.sqrt(np.mean(inlier**2)), rel=1e-9)


def test_without_inliers_nothing_has_converged(pair: tuple[Prepared, Prepared]) -> None:
    far = Alignment(se2(1000.0, 0.0, 0.0), True)
    result = judge.register(Answering(far), *pair, np.eye(4))
    assert (result.converged, result.inliers, result.fitness) == (False, 0, 0.0)


UNKNOWN = np.eye(4)
UNKNOWN[0, 3] = np.nan


@pytest.mark.parametrize(
    ("guess", "error"),
    [
        (np.diag([1.1, 1.1, 1.1, 1.0]), ValueError),
        (np.diag([1.0, -1.0, 1.0, 1.0]), ValueError),
        (UNKNOWN, ValueError),
        (np.eye(3), ValueError),
        (np.eye(4) + 0.1 * np.eye(4)[[1, 2, 3, 0]], ValueError),
        ([["a", "b"]], TypeError),
        (None, (TypeError, ValueError)),
    ],
)
def test_a_guess_that_is_no_rigid_motion(
    pair: tuple[Prepared, Prepared], guess: Any, error: Any
) -> None:
    with pytest.raises(error):
        Answering().register(*pair, guess)


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("wrong", [np.zeros((9, 3)), None, "cloud"], ids=["array", "none", "word"])
def test_what_is_not_prepared_is_the_callers_mistake(
    pair: tuple[Prepared, Prepared], side: int, wrong: Any
) -> None:
    given = [wrong if i == side else cloud for i, cloud in enumerate(pair)]
    with pytest.raises(TypeError, match=r"expected what prepare\(\) returns") as caught:
        Answering().register(*given, np.eye(4))
    assert ("source", "target")[side] in str(caught.value)


@pytest.mark.parametrize("kind", ["empty", "one_point", "nan", "infinite", "flat"])
def test_points_that_cannot_be_registered(scans: list[Scan], kind: str) -> None:
    points = scans[0].points.copy()
    if kind in ("nan", "infinite"):
        points[7, 1] = np.nan if kind == "nan" else np.inf
    points = {"empty": points[:0], "one_point": points[:1], "flat": points[:, :2]}.get(kind, points)
    before = scans[0].points.tobytes()
    with pytest.raises(BackendError):
        Answering().prepare(replace(scans[0], points=points))
    assert scans[0].points.tobytes() == before


@pytest.mark.parametrize(
    "error", [AttributeError, KeyError, NameError, NotImplementedError, TypeError, ImportError]
)
def test_a_programming_error_is_no_failed_registration(
    pair: tuple[Prepared, Prepared], error: type[Exception]
) -> None:
    with pytest.raises(error):
        Answering(error("oops")).register(*pair, np.eye(4))


@pytest.mark.parametrize("error", [RuntimeError, ValueError, np.linalg.LinAlgError, IndexError])
def test_a_library_that_raises_is_a_failed_registration(
    pair: tuple[Prepared, Prepared], error: type[Exception]
) -> None:
    with pytest.raises(BackendError, match=f"Answering: {error.__name__}: singular"):
        Answering(error("singular")).register(*pair, np.eye(4))


def test_an_answer_of_another_kind_names_the_plugin(pair: tuple[Prepared, Prepared]) -> None:
    with pytest.raises(
        TypeError, match=r"Answering\.align returned ndarray: expected an Alignment"
    ):
        Answering(np.eye(4)).register(*pair, np.eye(4))
    with pytest.raises(BackendError, match="no rigid motion"):
        Answering(Alignment(2.0 * np.eye(4))).register(*pair, np.eye(4))
    with pytest.raises(BackendError, match=r"information \(3, 3\): expected \(6, 6\)"):
        Answering(Alignment(np.eye(4), information=np.eye(3))).register(*pair, np.eye(4))


def test_the_loop_ends_at_a_programming_error() -> None:
    class Broken(Perfect):
        def align(self, source, target, T_target_source):
            return source.nativ

    with pytest.raises(AttributeError, match="nativ"):
        list(odometry(drive(3), method(Broken())))
