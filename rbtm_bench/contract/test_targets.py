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
    return PointsOnly(0.3)


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
    assert off.max() <= 0.01, (
        f"with the model scan's pose, target points lie up to {off.max():.3f} m off the walls: "
        "are they in the model scan's frame?"
    )
    own = window.node(model).prepared.points
    distance, _ = cKDTree(built.points).query(own)
    assert distance.max() <= 0.01, "the model scan itself is not in the target"


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
