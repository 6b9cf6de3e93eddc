"""The field's other rules for keyframes: spaciousness (DLIO), overlap (GLIM), nearest (MOLA)."""

from __future__ import annotations

import numpy as np
import pytest
from loop_helpers import Perfect, drive, method

from rbtm_bench.core.geometry import se2
from rbtm_bench.core.types import Array, Node, Scan
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.selection.base import Selector
from rbtm_bench.selection.nearest_keyframe import NearestKeyframe
from rbtm_bench.selection.overlap_keyframe import OverlapKeyframe
from rbtm_bench.selection.spacious_keyframe import SpaciousKeyframe


def models(selector: Selector, poses: list[Array], scores: list[float], ranges: list[float]):
    """The model scan of each scan after the first; every scan is a ring of points of one range."""
    window, chosen = selector.window(), []
    for scan, pose in enumerate(poses):
        if selector.needs_scans:
            points = ranges[scan] * np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0]])
            selector.see(Scan(scan, 0.0, points, True))
        if len(window):
            given = np.full(len(window), scores[scan])
            chosen.append(selector.choose(scan, window, given).candidates[0].model)
        window.push(Node(scan, 0.0, pose, descriptor=np.zeros(1)))
    return chosen


def straight(count: int) -> list[Array]:
    return [se2(0.25 * i, 0, 0) for i in range(count)]


@pytest.mark.parametrize(
    ("median", "expected"),
    [
        (1.0, [0, 1, 2, 3, 4, 5, 6]),  # 0.1 m, at least 0.2 m
        (5.0, [0, 0, 2, 2, 4, 4, 6]),  # 0.5 m
        (90.0, [0, 0, 0, 0, 4, 4, 4]),  # 9 m, at most 1 m
    ],
)
def test_distance_follows_the_median_range(median, expected) -> None:
    selector = SpaciousKeyframe(share=0.1, nearest=0.2, farthest=1.0)
    assert models(selector, straight(8), [0.0] * 8, [median] * 8) == expected


def test_spaciousness_is_filtered() -> None:
    """One long scan moves it by a twentieth of the difference: 5 + 0.05 (105 - 5) = 10 m."""
    selector = SpaciousKeyframe(share=1.0, nearest=0.1, farthest=100.0)
    selector.window()
    for scan, length in enumerate([5.0, 105.0]):
        selector.see(Scan(scan, 0.0, np.full((3, 3), length / np.sqrt(3)), False))
    last = Node(0, 0.0, se2(0, 0, 0))
    assert selector.is_new([last], Node(1, 0.0, se2(10.01, 0, 0)))
    selector.see(Scan(2, 0.0, np.zeros((0, 3)), False))  # nothing seen: as before
    assert not selector.is_new([last], Node(2, 0.0, se2(9.99, 0, 0)))


def test_overlap_decides() -> None:
    """A scan below the threshold is still matched to the last keyframe, and then is the next."""
    scores = [0.0, 0.9, 0.7, 0.69, 0.9, np.nan, 0.9]
    poses = [se2(0, 0, 0)] * 7
    assert models(OverlapKeyframe(below=0.7), poses, scores, []) == [0, 0, 0, 3, 3, 5]


def test_nearest_comes_back_to_old_keyframes() -> None:
    """Out by 0.25 m a scan and back: no new keyframe on the way back, and the old ones in turn."""
    out = [0.0, 0.25, 0.5, 0.75, 1.0]
    poses = [se2(x, 0, 0) for x in out + out[-2::-1]]
    selector = NearestKeyframe(distance=0.5, angle_deg=15.0)
    # members 0, 2, 4; half-way the older of equals
    assert models(selector, poses, [0.0] * 9, []) == [0, 0, 2, 2, 4, 2, 2, 0]


def test_nearest_counts_turns() -> None:
    """Back in place, turned by 180 deg: no keyframe sees that way, so it is one itself."""
    poses = [se2(0, 0, 0), se2(0.5, 0, 0), se2(0, 0, np.pi), se2(0, 0, np.pi), se2(0, 0, 0)]
    assert models(NearestKeyframe(0.5), poses, [0.0] * 5, []) == [0, 1, 2, 2]


def test_nearest_forgets_beyond_its_keyframes() -> None:
    poses = [se2(x, 0, 0) for x in (0, 1, 2, 0, 0)]
    assert models(NearestKeyframe(0.5, keyframes=2), poses, [0.0] * 5, []) == [0, 1, 2, 3]


def test_nearest_by_numbers_alone_is_refused() -> None:
    with pytest.raises(TypeError, match="choose"):
        NearestKeyframe().select(3, np.arange(3), np.ones(3))


def test_the_loop_shows_scans_without_truth() -> None:
    """To whoever asks for scans; each before it is selected for."""

    class Seeing(SpaciousKeyframe):
        def see(self, scan: Scan) -> None:
            assert scan.ground_truth is None
            super().see(scan)

    steps = list(odometry(drive(6), method(Perfect(), Seeing(0.05, 0.1, 5.0)), block=4))
    assert [step.record.status for step in steps[1:]] == ["registered"] * 5
