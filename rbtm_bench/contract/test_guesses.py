"""Every guess is a rigid motion of the right direction, and says truly what it depends on."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from rbtm_bench.backends.base import Alignment, Backend, Prepared
from rbtm_bench.contract.members import Catalogue, Member
from rbtm_bench.contract.scene import TinyClouds, rotation
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.geometry import inverse, is_rigid, se2, se3
from rbtm_bench.core.types import Array, Node, Scan
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.guess.base import Guess
from rbtm_bench.odometry import judge

GROUP = "guess"
STEPS = {
    "2d": se2(0.2, 0.05, 0.1),
    "3d": se3([0.2, 0.05, -0.02], rotation((0.1, 0.2, 1), 6)),
}
T_ODOM_WORLD = se2(3.0, -1.0, 0.7)
"""Odometry has a world frame of its own."""


@pytest.fixture
def guess(catalogue: Catalogue, member: Member) -> Guess:
    """The guess under test."""
    guess: Guess = catalogue.build(member)
    return guess


def drive(kind: str, count: int = 6) -> list[Array]:
    """True poses (4, 4) of an even motion."""
    poses = [se2(0.5, -0.3, 0.2)]
    for _ in range(count - 1):
        poses.append(poses[-1] @ STEPS[kind])
    return poses


def scan_at(index: int, T: Array, kind: str) -> Scan:
    """A scan with noise-free odometry."""
    points = np.random.default_rng(0).random((10, 3)) * [1, 1, kind != "2d"]
    return Scan(index, 0.1 * index, points, kind == "2d", odometry=T_ODOM_WORLD @ T)


def node_at(index: int, T: Array, estimate: Array | None = None) -> Node:
    """A past scan with noise-free odometry, at its true pose unless estimated elsewhere."""
    return Node(index, 0.1 * index, T if estimate is None else estimate, T_ODOM_WORLD @ T)


class Truth(Backend):
    """Knows the true motion between the scans of a drive."""

    def __init__(self, poses: list[Array]) -> None:
        super().__init__()
        self.poses = poses

    def build(self, points: Array, planar: bool) -> None:
        return None

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        (model, _), (scan, _) = target.key[0], source.key[0]
        return Alignment(inverse(self.poses[model]) @ self.poses[scan])


def show(guess: Guess, poses: list[Array], kind: str) -> None:
    """Let a guess see the scans of a drive, as the loop does."""
    backend = Truth(poses)
    for i, T in enumerate(poses):
        scan = scan_at(i, T, kind)
        seconds = guess.observe(scan, backend.prepare(scan), partial(judge.register, backend))
        assert seconds >= 0.0, f"observe() returned {seconds}: expected the seconds it took"


def predictions(guess: Guess, kind: str) -> list[tuple[int, int, Array]]:
    """(model, scan, T_model_scan) for every scan and every earlier model."""
    poses = drive(kind)
    nodes = [node_at(i, T) for i, T in enumerate(poses)]
    show(guess, poses, kind)
    motions = []
    for i in range(1, len(poses)):
        recent = deque(nodes[:i], maxlen=2)
        for model in nodes[:i]:
            motions.append(
                (model.scan, i, guess.predict(model, scan_at(i, poses[i], kind), recent))
            )
    return motions


@pytest.mark.parametrize("kind", ["2d", "3d"])
def test_a_guess_is_a_rigid_motion(guess: Guess, kind: str) -> None:
    for model, scan, T in predictions(guess, kind):
        where = f"T_{model}_{scan}"
        assert is_rigid(T), f"{where} is no rigid 4x4 motion:\n{T}"
        assert T.dtype == np.float64, f"{where} is {T.dtype}: expected float64"
        if kind == "2d":
            off = np.abs(np.concatenate([T[2], T[:, 2]]) - [0, 0, 1, 0, 0, 0, 1, 0]).max()
            assert off == 0, f"{where} leaves the plane by {off:.1e}, from planar poses"


@pytest.mark.parametrize("kind", ["2d", "3d"])
def test_noise_free_odometry_gives_the_true_motion(guess: Guess, kind: str) -> None:
    if not guess.needs_odometry:
        pytest.skip("uses no odometry")
    poses = drive(kind)
    for model, scan, T in predictions(guess, kind):
        truth = inverse(poses[model]) @ poses[scan]
        off = float(np.abs(T - truth).max())
        assert off <= 1e-9, (
            f"T_{model}_{scan} is {off:.2e} from the true motion, with noise-free odometry: is the "
            "direction right? Odometry poses are T_odom_sensor in a frame of their own"
        )


def test_a_guess_is_the_caller_s_to_change(guess: Guess) -> None:
    poses = drive("3d", 3)
    nodes = [node_at(i, T) for i, T in enumerate(poses)]
    show(guess, poses, "3d")
    new, before = scan_at(2, poses[2], "3d"), [T.tobytes() for T in poses]
    first = guess.predict(nodes[0], new, nodes[:2])
    kept = first.copy()
    first[:] = 7.0
    again = guess.predict(nodes[0], new, nodes[:2])
    assert again.tobytes() == kept.tobytes(), (
        "changing a returned guess changes the next: return a new array each time"
    )
    assert [T.tobytes() for T in poses] == before, "predict() modified a pose"


def test_a_pure_guess_does_not_look_at_the_trajectory(guess: Guess) -> None:
    if not guess.pure:
        pytest.skip("does not claim to be pure")
    poses = drive("3d", 4)
    show(guess, poses, "3d")
    elsewhere = [se2(9.0, i, 2.0) @ T for i, T in enumerate(poses)]
    new = scan_at(3, poses[3], "3d")
    nodes = [node_at(i, T) for i, T in enumerate(poses)]
    others = [node_at(i, T, e) for (i, T), e in zip(enumerate(poses), elsewhere, strict=True)]
    for model in range(3):
        first = guess.predict(nodes[model], new, nodes[1:3])
        for moved in (others[1:3], others[2:3]):
            second = guess.predict(others[model], new, moved)
            assert first.tobytes() == second.tobytes(), (
                "pure = True, but the guess changes with the estimated trajectory: registrations "
                "would be shared that are not the same"
            )


def test_check_asks_for_what_is_needed(guess: Guess) -> None:
    guess.check(Corridor(scans=2, beams=21))  # has everything
    clouds = TinyClouds()
    try:
        guess.check(clouds)
    except ConfigError:
        return
    assert not guess.needs_odometry, (
        "check() passes a data set without odometry, which needs_odometry = True says it needs"
    )
    poses = drive("3d", 3)
    show(guess, poses, "3d")
    nodes = [replace(node_at(i, T), odometry=None) for i, T in enumerate(poses)]
    T = guess.predict(nodes[0], clouds[2], nodes[:2])
    assert is_rigid(T), f"without odometry, which check() passes, the guess is\n{T}"
