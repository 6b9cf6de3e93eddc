"""Every target is what the backend prepared, in the frame of the model scan."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from rbtm_bench.backends.base import Alignment, Backend, Prepared
from rbtm_bench.contract.members import Catalogue, Member
from rbtm_bench.contract.scene import ROOM, planar_scan
from rbtm_bench.core.geometry import inverse, se2, transform
from rbtm_bench.core.types import Array, Node
from rbtm_bench.selection.window import Window
from rbtm_bench.target.base import Target

GROUP = "target"
REACH = 0.3
"""m, the backend's correspondence distance: nobody needs to know closer where the target is."""
POSES = [se2(0.1 * i, -0.05 * i, 0.1 * i) for i in range(6)]


class PointsOnly(Backend):
    """A backend that builds nothing and registers nothing."""

    def build(self, points: Array, planar: bool) -> Any:
        return None

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        raise AssertionError("a target must not register anything")


@pytest.fixture
def target(catalogue: Catalogue, member: Member) -> Target:
    """The target under test, new for every test: some remember the last one built."""
    target: Target = catalogue.build(member)
    return target


@pytest.fixture(scope="module")
def backend() -> PointsOnly:
    """Points are all that is looked at."""
    return PointsOnly(REACH)


@pytest.fixture
def window(backend: PointsOnly) -> Window:
    """Six scans of a room at their true poses."""
    window = Window(len(POSES))
    for i, T in enumerate(POSES):
        prepared = backend.prepare(planar_scan(T, i))
        window.push(Node(i, 0.1 * i, T, prepared=prepared))
    return window


def to_walls(points: Array) -> Array:
    """Distances (N,) m of points in the room's frame to its nearest wall."""
    start, along = ROOM[:, 0], ROOM[:, 1] - ROOM[:, 0]
    gap = points[:, None, :2] - start
    share = np.clip((gap * along).sum(-1) / (along**2).sum(-1), 0, 1)
    distances: Array = np.linalg.norm(gap - share[..., None] * along, axis=-1).min(axis=1)
    return distances


@pytest.mark.parametrize("model", [0, 3, 5])
def test_the_target_lies_in_the_model_scan_s_frame(
    target: Target, window: Window, backend: PointsOnly, model: int
) -> None:
    built = target.build(model, window, backend)
    assert isinstance(built, Prepared), f"build() gave {type(built).__name__}: expected Prepared"
    assert built.planar, "planar scans made a target that is not planar"
    off = to_walls(transform(POSES[model], built.points))
    # a mean of points around a corner lies within it
    assert off.max() <= 0.05 and np.quantile(off, 0.9) <= 0.01, (
        f"with the model scan's pose, target points lie up to {off.max():.3f} m off the walls: "
        "are they in the model scan's frame?"
    )
    own = window.node(model).prepared.points
    distance, _ = cKDTree(built.points).query(own)
    # a map may forget what is out of the newest scan's range
    assert np.quantile(distance, 0.9) <= REACH, "the model scan itself is not in the target"


def test_building_repeats_and_modifies_nothing(
    target: Target, window: Window, backend: PointsOnly
) -> None:
    before = [node.prepared.points.tobytes() for node in window.nodes]
    first = target.build(3, window, backend).points.tobytes()
    target.build(1, window, backend)
    again = target.build(3, window, backend).points.tobytes()
    assert first == again, "building the same target again gives other points"
    after = [node.prepared.points.tobytes() for node in window.nodes]
    assert after == before, "build() modified a scan of the window"


def test_a_window_of_one_scan_will_do(target: Target, backend: PointsOnly) -> None:
    window = Window(1)
    T = inverse(POSES[2])
    window.push(Node(7, 0.7, T, prepared=backend.prepare(planar_scan(T, 7))))
    assert len(target.build(7, window, backend).points), "an empty target from a window of one"


def test_every_selector_fills_it(target: Target, backend: PointsOnly) -> None:
    """The window that it declares, beside a selector's that holds the newest scan alone: no scan
    is handed to it twice, and what it remembers stays bounded."""
    selected = Window(1)
    past = target.window(selected)
    assert isinstance(past, Window), f"window() gave {type(past).__name__}: expected a Window"
    assert len(past) == 0, "the window of a new run is not empty"
    for i in range(60):
        T = se2(0.05 * i, 0.0, 0.0)
        node = Node(i, 0.1 * i, T, prepared=backend.prepare(planar_scan(T, i)))
        for window in {id(one): one for one in (selected, past)}.values():
            window.push(node)
        built = target.build(i, past, backend)
        assert max(number for number, _ in built.key) <= i, "a target of scans to come"
    assert len(past) <= past.capacity
    off = to_walls(transform(T, built.points))
    assert np.quantile(off, 0.9) <= 0.01, "the target is not in the newest scan's frame"
    assert target.window(selected) is not past or past is selected, "two runs share a window"


def test_a_run_knows_nothing_of_another(target: Target, backend: PointsOnly) -> None:
    """Two runs of one object, by turns: each as if it were alone."""
    alone = [whole(target, backend, shift).points.tobytes() for shift in (0.0, 0.3)]
    windows = [filled(target, backend, shift) for shift in (0.0, 0.3)]
    by_turns = [target.build(5, window, backend) for window in windows]
    assert [one.points.tobytes() for one in by_turns] == alone, "one run saw another's scans"


def filled(target: Target, backend: PointsOnly, shift: float) -> Window:
    """The target's window after six scans along a line ``shift`` m off."""
    selected = Window(3)
    past = target.window(selected)
    for i in range(6):
        T = se2(0.1 * i, shift, 0.0)
        node = Node(i, 0.1 * i, T, prepared=backend.prepare(planar_scan(T, i)))
        for window in {id(one): one for one in (selected, past)}.values():
            window.push(node)
    return past


def whole(target: Target, backend: PointsOnly, shift: float) -> Prepared:
    """What it builds of them."""
    return target.build(5, filled(target, backend, shift), backend)
