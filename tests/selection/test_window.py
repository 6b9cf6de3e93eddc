"""The sliding window against a plain list."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rbtm_bench.core.geometry import se2
from rbtm_bench.core.types import Node
from rbtm_bench.selection.window import Keyframes, Window


def node(scan: int, x: float = 0.0, theta: float = 0.0, dtype: type = float) -> Node:
    descriptor = np.array([scan, -scan, 0.5], dtype=dtype)
    return Node(scan, float(scan), se2(x, 0, theta), descriptor=descriptor)


def assert_same(window: Window, members: list[Node]) -> None:
    """The window holds exactly these nodes, in every one of its forms."""
    assert len(window) == len(members)
    assert window.nodes == members
    assert window.scans.tolist() == [m.scan for m in members]
    expected = np.array([m.descriptor for m in members]).reshape(len(members), -1)
    np.testing.assert_array_equal(window.descriptors, expected)
    for position, member in enumerate(members):
        assert window.position(member.scan) == position
        assert window.node(member.scan) is member


@given(
    capacity=st.integers(1, 9),
    steps=st.lists(st.integers(1, 4), max_size=60),
    dtype=st.sampled_from([float, complex, np.float32]),
)
def test_it_is_the_end_of_a_list(capacity, steps, dtype) -> None:
    """Scan numbers rise by one or more: some scans are left out."""
    window, members = Window(capacity), []
    assert len(window) == 0 and window.scans.shape == (0,) and window.descriptors.shape == (0, 0)
    for scan in np.cumsum(steps):
        members.append(node(int(scan), dtype=dtype))
        window.push(members[-1])
        assert_same(window, members[-capacity:])


@given(
    capacity=st.integers(1, 5),
    moves=st.lists(st.tuples(st.integers(-3, 3), st.integers(-9, 9)), max_size=40),
)
def test_keyframes_are_the_end_of_a_list_of_keyframes(capacity, moves) -> None:
    """Moves of multiples of 0.25 m and 5 deg; two or three of them make a keyframe."""
    window, members = Window(capacity, Keyframes(distance=0.49, angle_deg=14.9)), []
    x = turn = 0
    for scan, (dx, dturn) in enumerate(moves):
        x, turn = x + dx, turn + dturn
        new = node(scan, 0.25 * x, np.radians(5.0 * turn))
        if members:
            at, heading = members[-1][1:]
            far = abs(x - at) >= 2
            turned = min((turn - heading) % 72, (heading - turn) % 72) >= 3
        if not members or far or turned:
            members.append((new, x, turn))
        window.push(new)
        assert_same(window, [m[0] for m in members[-capacity:]])


def test_memory_is_bounded_by_the_capacity() -> None:
    window = Window(10)
    for scan in range(1000):
        window.push(node(scan))
    buffer = window.descriptors.base
    assert buffer is not None and len(buffer) == 20
    assert len(window.nodes) == 10


def test_without_descriptors() -> None:
    """Strategies that need no scores describe nothing."""
    window = Window(3)
    for scan in range(5):
        window.push(Node(scan, 0.0, np.eye(4)))
    assert window.scans.tolist() == [2, 3, 4]
    assert window.descriptors.shape == (3, 0)


@pytest.mark.parametrize("scan", [-1, 0, 3, 7])
def test_a_scan_that_is_not_there(scan) -> None:
    window = Window(3)
    for member in (0, 1, 2, 4):
        window.push(node(member))
    with pytest.raises(KeyError, match=f"scan {scan} is not in the window"):
        window.node(scan)


def test_an_empty_window_knows_no_scan() -> None:
    with pytest.raises(KeyError):
        Window(2).position(0)


def test_a_capacity_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="expected at least 1"):
        Window(0)


def test_a_window_in_metres_keeps_what_was_travelled() -> None:
    """0.5 m forth and 0.5 m back are 1 m, though the robot is where it was."""
    window = Window(10, length=1.0)
    for scan, (x, members) in enumerate(
        [
            (0.0, [0]),
            (0.5, [0, 1]),
            (0.0, [0, 1, 2]),
            (0.25, [1, 2, 3]),
            (5.25, [4]),
            (5.25, [4, 5]),
        ]
    ):
        window.push(node(scan, x))
        assert window.scans.tolist() == members
        assert [m.scan for m in window.nodes] == members
        assert window.is_full == (scan >= 3)


def test_travelling_counts_between_keyframes() -> None:
    """Keyframes every 0.5 m; what lies between them ages those kept, by every bend of the way."""
    window = Window(10, Keyframes(distance=0.5, angle_deg=90.0), length=0.7)
    for scan, (x, members) in enumerate(
        [(0.0, [0]), (0.3, [0]), (0.1, [0]), (0.25, [0]), (0.5, [4]), (0.9, [4])]
    ):
        window.push(node(scan, x))
        assert window.scans.tolist() == members, scan


def test_the_capacity_holds_beside_metres() -> None:
    window = Window(2, length=100.0)
    for scan in range(4):
        assert window.is_full == (scan >= 2)
        window.push(node(scan, 0.1 * scan))
    assert window.scans.tolist() == [2, 3]
