"""Settings that follow from the data's first part, without truth, before a run begins.

``selector.threshold=auto`` and distances of keyframes relative to the scene (``..._relative``).
A tenth of the scans, at most 300, say it: for a threshold so many with a full window across which
the robot moved, and the first part goes on until it has them, to half of the scans at most. A live
system would drive it first; a run goes over it as well, with what it determined.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.geometry import inverse, rotation_angle, translation_norm
from rbtm_bench.core.types import Array, Node
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.odometry.method import Method, Work
from rbtm_bench.pairs.shared import SharedDataset
from rbtm_bench.pairs.watched import WatchedWork
from rbtm_bench.selection.base import Selection, Selector
from rbtm_bench.selection.thresholded import AUTO
from rbtm_bench.selection.window import Window

SHARE, MOST, LEAST, LIMIT = 0.1, 300, 20, 0.5
"""Of all scans that say it, their share, how many at most and at least; and the share of all scans
that they are looked for in."""
MOVED, TURNED_DEG = 0.01, 1.0
"""A window across which the robot moved less than this share of the median range and turned less
than this tells nothing of thresholds."""
THRESHOLD = "selector.threshold"
NEARLY = 0.8
UNDECIDED = 0.7
"""Where no threshold decides: the paper's corridor's."""
DIGITS = 4
"""Of a threshold, so that what is printed can be given again."""
DISTANCES = {"distance": "distance_relative", "keyframe_distance": "keyframe_distance_relative"}


class Span(NamedTuple):
    """What a full window said of a new scan: the score of its oldest member and the highest of the
    others (NaN: undefined)."""

    oldest: float
    highest: float


def scans_of(count: int) -> int:
    """How many of ``count`` scans say what settings are left to."""
    return min(count, max(min(int(SHARE * count), MOST), LEAST))


def median_range(dataset: Dataset) -> float:
    """The median over the first part's scans of their median range (m)."""
    ranges = [
        float(np.median(np.linalg.norm(scan.points, axis=1)))
        for scan in islice(iter(dataset), scans_of(len(dataset)))
        if len(scan.points)
    ]
    if not ranges:
        raise DataError("the first part of the data has no points to take the median range of")
    return float(np.median(ranges))


def distances(config: Mapping[str, Any], dataset: Dataset) -> dict[str, float]:
    """The selector's distances (m) that are not given but relative to the scene, by dotted key."""
    node = config.get("selector") or {}
    asked = [
        (key, node[relative])
        for key, relative in DISTANCES.items()
        if key in node and node[key] is None and node.get(relative) is not None
    ]
    if not asked or (node.get("content", "keyframes") == "scans"):
        return {}
    scale = median_range(dataset)
    return {f"selector.{key}": float(f"{share * scale:.3g}") for key, share in asked}


def filled(config: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """The config with these values of dotted keys."""
    made = dict(config)
    for key, value in values.items():
        group, _, name = key.partition(".")
        made[group] = {**made[group], name: value}
    return made


class Pilot(Selector):
    """Matches every scan to the one before, with another selector's window, and writes down what
    the similarity says of its members."""

    needs_scores = True

    def __init__(self, of: Selector, moved_m: float) -> None:
        super().__init__(of.capacity)
        self._of, self._moved_m = of, moved_m
        self.spans: list[Span] = []

    def window(self) -> Window:
        return self._of.window()

    def choose(self, scan: int, window: Window, scores: Array) -> Selection:
        if window.is_full and len(scores) > 1 and self._has_moved(window.nodes):
            others = scores[1:][np.isfinite(scores[1:])]
            self.spans.append(Span(float(scores[0]), float(others.max(initial=-np.inf))))
        return super().choose(scan, window, scores)

    def order(self, scan: int, models: NDArray[np.int64], scores: Array) -> list[tuple[int, str]]:
        return [(len(models) - 1, "pilot")]

    def _has_moved(self, nodes: Sequence[Node]) -> bool:
        T = inverse(nodes[0].T_world_scan) @ nodes[-1].T_world_scan
        turned = float(rotation_angle(T)) >= np.radians(TURNED_DEG)
        return turned or float(translation_norm(T)) >= self._moved_m


class Determined(NamedTuple):
    """What settings leave to the data: ``values`` by dotted key, and where they are from in
    ``words``, a line each."""

    values: dict[str, float]
    words: tuple[str, ...] = ()


def determined(
    config: Mapping[str, Any],
    dataset: SharedDataset,
    make: Callable[[Mapping[str, Any]], Method],
) -> Determined:
    """What a run's settings leave to the data; ``make`` gives the method of a config."""
    values = distances(config, dataset)
    count = scans_of(len(dataset))
    words = [
        f"{key}={value:g} m, relative to the median range of the first {count} scans"
        for key, value in values.items()
    ]
    if (config.get("selector") or {}).get("threshold") == AUTO:
        values[THRESHOLD], how = threshold(dataset, make(filled(config, values)))
        words.append(how)
    return Determined(values, tuple(words))


def threshold(dataset: SharedDataset, method: Method) -> tuple[float, str]:
    """The threshold that decides the first part (``deciding``), and in words how many scans;
    ``UNDECIDED``, with a caution, where none decides any.

    The method itself, but with the scan before as its model scan, goes over the first part with its
    own window, similarity and guess.
    """
    pilot = Pilot(method.selector, MOVED * median_range(dataset))
    wanted, most = scans_of(len(dataset)), max(int(LIMIT * len(dataset)), LEAST)
    piloted = replace(method, selector=pilot)
    work = None if dataset.watch is None else WatchedWork(Work(piloted), dataset.watch)
    count = 0
    for _ in odometry(islice(iter(dataset), most), piloted, work):
        count += 1
        if len(pilot.spans) >= wanted:
            break
    value, share = deciding(pilot.spans)
    of = f"of {len(pilot.spans)} full windows in motion among the first {count} scans"
    if share == 0.0:
        why = f"no threshold decides any {of}: {value:g} as in the paper's corridor"
        return value, f"caution: {THRESHOLD}=auto: {why}"
    return value, f"{THRESHOLD}={value:g} decides {share:.0%} {of} (auto)"


def deciding(spans: Sequence[Span]) -> tuple[float, float]:
    """The highest threshold Th that decides at least ``NEARLY`` as many scans as any does, and the
    share of ``spans`` that it decides.

    A scan is decided if it picks neither the oldest member nor none: the oldest score is not > Th,
    another is. Counted exactly, between any two scores; the middle of the two is given. The
    highest, as a wrong match costs more than a shorter gap. ``UNDECIDED`` and 0 where none decides.
    """
    low = np.array([-1.0 if np.isnan(s.oldest) else s.oldest for s in spans])
    high = np.array([s.highest for s in spans])
    low, high = np.sort(low[high > low]), np.sort(high[high > low])
    if not len(low):
        return UNDECIDED, 0.0
    ends = np.unique(np.concatenate([low, high]))
    counts = np.searchsorted(low, ends, "right") - np.searchsorted(high, ends, "right")
    at = int(np.flatnonzero(counts >= NEARLY * counts.max())[-1])
    # between this end and the next the count stays
    return round(float(0.5 * (ends[at] + ends[at + 1])), DIGITS), int(counts[at]) / len(spans)
