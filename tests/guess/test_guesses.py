"""Initial guesses against motions worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.core.errors import BackendError, ConfigError
from rbtm_bench.core.geometry import inverse, se2
from rbtm_bench.core.types import Array, Node, RegistrationResult, Scan
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.guess.base import Guess
from rbtm_bench.guess.constant_velocity import ConstantVelocity
from rbtm_bench.guess.identity import Identity
from rbtm_bench.guess.odometry import Odometry, OdometryChained
from rbtm_bench.guess.odometry_chain import OdometryChain

QUARTER = np.pi / 2


def node(index: int, pose: Array, odometry: Array | None = None) -> Node:
    return Node(index, 0.1 * index, pose, odometry)


def scan(index: int, odometry: Array | None = None) -> Scan:
    return Scan(index, 0.1 * index, np.zeros((0, 3)), odometry=odometry)


def test_identity() -> None:
    first, last = node(0, se2(1, 2, 3)), node(4, se2(5, 6, 7))
    T = Identity().predict(first, scan(5), [last])
    np.testing.assert_array_equal(T, np.eye(4))
    T[0, 3] = 9.0  # whoever writes into a guess must not change the next one
    np.testing.assert_array_equal(Identity().predict(first, scan(5), [last]), np.eye(4))


def test_constant_velocity_by_hand() -> None:
    """The last motion is 1 m ahead and a quarter turn left. From (3, 0) facing +y, again: to
    (3, 1) facing -x, which is 1 m ahead of the last and (3, 1) seen from the origin."""
    before, last = node(1, se2(2, 0, 0)), node(2, se2(3, 0, QUARTER))
    origin = node(0, np.eye(4))
    guess = ConstantVelocity()
    np.testing.assert_allclose(
        guess.predict(last, scan(3), [before, last]), se2(1, 0, QUARTER), atol=1e-12
    )
    np.testing.assert_allclose(
        guess.predict(origin, scan(3), [before, last]), se2(3, 1, np.pi), atol=1e-12
    )


def test_constant_velocity_stands_still_at_the_start() -> None:
    """With one scan nothing is known of the motion."""
    first = node(0, se2(4, 5, 1))
    T = ConstantVelocity().predict(first, scan(1), [first])
    np.testing.assert_allclose(T, np.eye(4), atol=1e-12)


def test_odometry_is_a_matter_of_the_pair() -> None:
    """Odometry went from (1, 1) facing +y to (1, 3) facing -x: 2 m ahead and a quarter turn left.
    What the trajectory or the scans between say does not count."""
    model = node(3, se2(40, 50, 2), se2(1, 1, QUARTER))
    new = scan(9, se2(1, 3, np.pi))
    for recent in ([node(8, se2(-7, 0, 1), se2(6, 6, 6))], [model]):
        T = Odometry().predict(model, new, recent)
        np.testing.assert_allclose(T, se2(2, 0, QUARTER), atol=1e-12)


def test_odometry_chained_by_hand() -> None:
    """The estimate says that the previous scan is 2 m to the left of the model, facing +y;
    odometry adds 1 m ahead: 3 m to the left. Their odometry between the two does not count."""
    model = node(0, se2(10, 0, 0), se2(77, 7, 7))
    last = node(5, se2(10, 2, QUARTER), se2(0, 0, 0.5))
    new = scan(6, se2(0, 0, 0.5) @ se2(1, 0, 0))
    T = OdometryChained().predict(model, new, [node(4, np.eye(4), np.eye(4)), last])
    np.testing.assert_allclose(T, se2(0, 3, QUARTER), atol=1e-12)


@pytest.mark.parametrize("guess", [ConstantVelocity(), Odometry(), OdometryChained()])
def test_all_agree_where_odometry_is_right_and_motion_is_even(guess) -> None:
    step = se2(0.1, 0.02, 0.05)
    poses = [np.linalg.matrix_power(step, i) for i in range(7)]
    world = se2(3, 4, 1)  # the frames of odometry and of the estimate are not the same
    nodes = [node(i, pose, world @ pose) for i, pose in enumerate(poses)]
    T = guess.predict(nodes[2], scan(6, world @ poses[6]), nodes[4:6])
    np.testing.assert_allclose(T, inverse(poses[2]) @ poses[6], atol=1e-12)


def test_pure_guesses_are_those_of_the_pair_alone() -> None:
    guesses: list[Guess] = [Identity(), Odometry(), ConstantVelocity(), OdometryChained()]
    assert [guess.pure for guess in guesses] == [True, True, False, False]
    assert [guess.needs_odometry for guess in guesses] == [False, True, False, True]


def test_odometry_chain_by_hand() -> None:
    """Every registration begins from the wheels and ends half as far; one that fails keeps them.
    C is 0, 0.5, 1.0 and, unregistered, 2.0 m: from scan 1 to 3 it is 1.5 m."""
    starts: list[float] = []

    def register(source: int, target: int, T: Array) -> RegistrationResult:
        starts.append(T[0, 3])
        if source == 3:
            raise BackendError("too few points")
        return RegistrationResult(se2(0.5 * T[0, 3], 0, 0), True, 1.0, 0.0, 9, seconds=0.25)

    guess = OdometryChain()
    seconds = [guess.observe(scan(i, se2(i, 0, 0)), i, register) for i in range(4)]
    assert starts == [1.0, 1.0, 1.0] and seconds == [0.0, 0.25, 0.25, 0.0]
    T = guess.predict(node(1, se2(9, 9, 9)), scan(3), [])
    np.testing.assert_allclose(T, se2(1.5, 0, 0), atol=1e-12)
    assert guess.observe(scan(2, se2(2, 0, 0)), 2, register) == 0.25 and len(starts) == 3
    assert guess.pure and guess.needs_odometry and guess.needs_backend


class EmptyDrive(Dataset):
    def __init__(self, has_odometry: bool) -> None:
        self.has_odometry = has_odometry

    def __len__(self) -> int:
        return 0

    def __getitem__(self, index: int) -> Scan:
        raise IndexError

    def fingerprint(self) -> str:
        return ""


@pytest.mark.parametrize("guess", [Odometry(), OdometryChained()])
def test_a_data_set_without_odometry_is_refused(guess) -> None:
    with pytest.raises(
        ConfigError, match=r"\(EmptyDrive\) does not have: use guess=constant_velocity"
    ):
        guess.check(EmptyDrive(has_odometry=False))
    guess.check(EmptyDrive(has_odometry=True))


@pytest.mark.parametrize("guess", [Identity(), ConstantVelocity()])
def test_the_others_take_any_data_set(guess) -> None:
    guess.check(EmptyDrive(has_odometry=False))
