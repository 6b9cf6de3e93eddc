"""What a data set holds, in numbers and in words: a screen before anything is run on it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from rbtm_bench.core.types import Array
from rbtm_bench.datasets.base import Dataset

LOOKED_AT = 200
"""Scans at most, spread over the data set, unless all are asked for."""
EDGES = (0.0, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, np.inf)
"""m, of the histogram of ranges."""
GAP = 5.0
"""Times the median step: a longer one is a gap."""
NEIGHBOURS = 500
"""Points of a scan whose nearest neighbour is looked for."""
WIDTH = 100
"""Columns of a screen."""


@dataclass
class Seen:
    """What was found in the scans that were looked at."""

    scans: int = 0
    points: list[int] = field(default_factory=list)
    histogram: Array = field(default_factory=lambda: np.zeros(len(EDGES) - 1))
    low: Array = field(default_factory=lambda: np.full(3, np.inf))
    high: Array = field(default_factory=lambda: np.full(3, -np.inf))
    spacing: list[float] = field(default_factory=list)
    beams: set[int] = field(default_factory=set)
    stamps: list[float] = field(default_factory=list)


def head(dataset: Dataset) -> list[str]:
    """The short form: how the data are read and what looks wrong, a line each."""
    return [f"data: {reading}" for reading in dataset.readings] + [
        f"data: caution: {text}" for text in dataset.suspicions
    ]


def tell(dataset: Dataset) -> None:
    """Print the short form beside the results."""
    for line in head(dataset):
        print(line, file=sys.stderr)


def report(dataset: Dataset, every: bool = False) -> list[str]:
    """A screen of lines; ``every`` looks at all scans. Raises ``DataError`` for a bad scan."""
    seen = _looked(dataset, every)
    stamps = np.array(getattr(dataset, "stamps", seen.stamps))
    lines = [("scans", _scans(dataset, seen)), ("time", _time(stamps, len(dataset)))]
    spread = np.percentile(seen.points, [0, 50, 100]).astype(int)
    lines.append(("points", f"{spread[0]} to {spread[2]} a scan, half have {spread[1]} or more"))
    shares = seen.histogram / max(seen.histogram.sum(), 1)
    bins = zip(EDGES[:-1], EDGES[1:], shares, strict=True)
    texts = [f"{a:g}-{b:g} m {share:.1%}" for a, b, share in bins if share]
    lines.append(("ranges", "  ".join(texts).replace("100-inf m", "100 m on")))
    extent = " x ".join(
        f"{low:.1f}..{high:.1f}" for low, high in zip(seen.low, seen.high, strict=True)
    )
    lines.append(("extent", f"{extent} m in the sensor's frame"))
    if seen.spacing:
        lines.append(("spacing", f"{np.median(seen.spacing):.3g} m to the next point (median)"))
    lines.append(("left out", _dropped(dataset, seen)))
    lines += [(f"{role} path", text) for role, text in _paths(dataset, seen)]
    lines += [(reading.what, str(reading).partition(": ")[2]) for reading in dataset.readings]
    lines += [("caution", text) for text in dataset.suspicions]
    return [part for name, text in lines for part in _wrapped(name, text)]


def _wrapped(name: str, text: str) -> Iterator[str]:
    import textwrap

    yield from textwrap.wrap(
        text, WIDTH, initial_indent=f"{name:<14}", subsequent_indent=" " * 14, break_long_words=True
    )


def _looked(dataset: Dataset, every: bool) -> Seen:
    from scipy.spatial import cKDTree

    seen = Seen()
    count = len(dataset) if every else min(LOOKED_AT, len(dataset))
    for index in np.unique(np.linspace(0, len(dataset) - 1, count).round().astype(int)):
        scan = dataset[int(index)]
        points = scan.points
        seen.scans += 1
        seen.stamps.append(scan.stamp)
        seen.points.append(len(points))
        seen.beams.add(0 if scan.ranges is None else len(scan.ranges))
        if len(points) == 0:
            continue
        seen.histogram += np.histogram(np.linalg.norm(points, axis=1), EDGES)[0]
        seen.low = np.minimum(seen.low, points.min(axis=0))
        seen.high = np.maximum(seen.high, points.max(axis=0))
        if len(points) > 1:
            some = points[:: max(1, len(points) // NEIGHBOURS)]
            seen.spacing.append(float(np.median(cKDTree(points).query(some, k=2)[0][:, 1])))
    return seen


def _scans(dataset: Dataset, seen: Seen) -> str:
    kind = "planar" if dataset.planar else "3D"
    beams = f", {max(seen.beams)} beams" if dataset.has_beams else ""
    looked = "" if seen.scans == len(dataset) else f"; below: {seen.scans} of them, evenly spread"
    skipped = f", {dataset.skipped} malformed records left out" if dataset.skipped else ""
    return f"{len(dataset)}, {kind}{beams}{skipped}{looked}"


def _time(stamps: Array, scans: int) -> str:
    if len(stamps) < 2 or len(stamps) < scans:
        return f"{stamps[0]:.3f} s" if len(stamps) else "unknown"
    steps = np.diff(stamps)
    forward = steps[steps > 0]
    middle = float(np.median(forward)) if len(forward) else 0.0
    gaps = forward[forward > GAP * middle]
    rate = f"{1 / middle:.3g} Hz" if middle else "no rate"
    words = [f"{np.ptp(stamps):.6g} s from {stamps.min():.6f} s on, {rate} (median)"]
    longest = f", the longest {gaps.max():.3g} s" if len(gaps) else ""
    words.append(f"{len(gaps)} gaps of {GAP:g} steps or more{longest}")
    words.append(f"{np.count_nonzero(steps < 0)} steps back")
    words.append(f"{len(stamps) - len(np.unique(stamps))} repeated stamps")
    return "; ".join(words)


def _dropped(dataset: Dataset, seen: Seen) -> str:
    dropped = dataset.dropped()
    total = sum(seen.points) + sum(dropped.values())
    texts = [f"{count} {cause} ({count / total:.2%})" for cause, count in dropped.items()]
    return f"{', '.join(texts) or 'none'} of {total} points"


def _paths(dataset: Dataset, seen: Seen) -> Iterator[tuple[str, str]]:
    """Lengths of odometry and truth where the data set holds them whole."""
    for role, name in (("odometry", "odometry"), ("truth", "ground_truth")):
        poses = getattr(dataset, name, None)
        if isinstance(poses, dict):
            poses = np.array(list(poses.values()))
        if poses is None or len(poses) < 2:
            continue
        known = poses[np.isfinite(poses).all(axis=(1, 2))]
        steps = np.linalg.norm(np.diff(known[:, :3, 3], axis=0), axis=1)
        longest = f"the longest step {steps.max():.3g} m" if len(steps) else "no step"
        yield role, f"{steps.sum():.4g} m over {len(known)} of {len(dataset)} scans, {longest}"
