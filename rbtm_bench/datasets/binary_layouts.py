"""Point files without a header (.bin): which layout the bytes have, told from the bytes.

A layout is possible if its record divides the file's size and its points are plausible. Of several
the right one is that whose fields are alike from record to record: with another length of record
x, y, z and intensity follow each other at random.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.files import file_size

FARTHEST = 1e4
"""m; no laser sees farther."""
SMALLEST = 1e-30
"""Numbers that are smaller, but not 0, are bytes of something else."""
ABSURD_SHARE = 0.01
"""Of the coordinates may be implausible: a flipped bit, not another layout."""
LOOKED_AT = 4096
"""Records at the start of a file that are looked at."""
FEW = 8
"""Records that say nothing."""
DOUBTS = 4 * 0.24
"""Differences of ranks have a deviation of 0.24 if drawn at random: four deviations of a mean."""


@dataclass(frozen=True)
class Layout:
    """Records of numbers of one type, x y z first; ``scale`` and ``shift`` make metres of them."""

    name: str
    words: str
    dtype: str
    fields: int
    scale: float = 1.0
    shift: float = 0.0

    @property
    def record(self) -> int:
        """Bytes of a record."""
        return self.fields * np.dtype(self.dtype).itemsize

    def points(self, content: bytes | NDArray[np.uint8]) -> Array:
        """Points (N, 3) m of whole records."""
        rows = np.frombuffer(content, self.dtype).reshape(-1, self.fields)
        with np.errstate(all="ignore"):  # bytes of something else may be odd NaNs
            points: Array = rows[:, :3].astype(np.float64)
        return points if self.scale == 1.0 else self.scale * points + self.shift


LAYOUTS = {
    layout.name: layout
    for layout in (
        Layout("kitti", "x y z intensity, float32", "<f4", 4),
        Layout("nuscenes", "x y z intensity ring, float32", "<f4", 5),
        Layout("boreas", "x y z intensity ring time, float32", "<f4", 6),
        Layout("xyz", "x y z, float32", "<f4", 3),
        Layout("xyz64", "x y z, float64", "<f8", 3),
        Layout("xyzi64", "x y z intensity, float64", "<f8", 4),
        Layout(
            "nclt",
            "x y z as uint16 of 5 mm from -100 m, intensity and ring",
            "<u2",
            4,
            5e-3,
            -100.0,
        ),
    )
}


SWAPPED = tuple(
    Layout(f"{one.name}, bytes swapped", one.words, one.dtype.replace("<", ">"), one.fields)
    for one in LAYOUTS.values()
    if one.dtype != "<u2"
)
"""Looked for to be refused by name."""


def read_layout(path: Path, layout: str) -> Array:
    """Points (N, 3) m of a file of known layout. Raises ``DataError`` where it does not fit."""
    known = LAYOUTS[layout]
    size = file_size(path)
    if size % known.record:
        raise DataError(
            f"{path}: {size} bytes are no whole number of records of {known.record} bytes "
            f"(layout={layout}: {known.words})"
        )
    return known.points(np.fromfile(path, np.uint8))


def find_layout(paths: Sequence[Path]) -> tuple[str, str]:
    """The layout that all files have, and why. Raises ``DataError`` where none or several fit."""
    sizes = [file_size(path) for path in paths]
    looked_at = [paths[i] for i in sorted({0, len(paths) // 2, len(paths) - 1})]
    costs: dict[str, float] = {}
    known = {**LAYOUTS, **{one.name: one for one in SWAPPED}}
    fitting = [one for one in known.values() if not any(size % one.record for size in sizes)]
    for layout in fitting:
        found = [_cost(path, layout) for path in looked_at]
        if np.isfinite(found).all():
            costs[layout.name] = float(np.mean(found))
    if not costs:
        which = ", ".join(f"{one.name} ({one.record} bytes)" for one in LAYOUTS.values())
        raise DataError(
            f"{paths[0]}: its {sizes[0]} bytes are plausible points in none of the layouts "
            f"{which}: dataset.layout= says which"
        )
    best = min(costs, key=lambda name: (round(costs[name], 12), known[name].record))
    record = known[best].record
    if min(sizes) < FEW * record:
        if "kitti" in costs:
            return "kitti", "too few points to tell"
        raise DataError(f"{paths[0]}: too few points to tell the layout: dataset.layout= says it")
    noise = DOUBTS / np.sqrt(min(LOOKED_AT, min(sizes) // record) * known[best].fields)
    rivals = [name for name in costs if costs[best] > costs[name] - noise and name != best]
    rivals = [name for name in rivals if known[name].record % record]
    if rivals:
        words = " or ".join(f"{n} ({known[n].words})" for n in (best, *rivals))
        raise DataError(f"{paths[0]}: layout {words}? dataset.layout= says which")
    unlike = min(_cost(paths[0], known[best], shift) for shift in range(1, known[best].fields))
    if costs[best] > unlike - noise:
        raise DataError(
            f"{paths[0]}: records of {record} bytes ({best}) fit its size, but are "
            "not alike: dataset.layout= says which layout it has"
        )
    if best not in LAYOUTS:
        raise DataError(f"{paths[0]}: {best}: such files are not read")
    others = [one.name for one in fitting if one.name != best and one.name in LAYOUTS]
    why = f"fields alike from record to record, not as {', '.join(others)}" if others else "size"
    return best, why


def absurd(values: Array) -> NDArray[np.bool_]:
    """Which numbers are no coordinates: NaN, infinite, beyond 10 km, or next to nothing."""
    size = np.abs(values)
    return ~(size <= FARTHEST) | ((size > 0) & (size < SMALLEST))


def _cost(path: Path, layout: Layout, shift: int = 0) -> float:
    """Mean difference of the ranks (0 to 1) of numbers a record (and ``shift`` fields) apart, less
    the share of equal ones; infinite for points that are implausible."""
    with path.open("rb") as file:
        content = file.read(LOOKED_AT * layout.record)
    points = layout.points(content[: len(content) // layout.record * layout.record])
    if absurd(points).mean() > ABSURD_SHARE or not points.any():
        return np.inf
    if len(points) < FEW:
        return 0.0
    with np.errstate(invalid="ignore"):
        flat = np.frombuffer(content, layout.dtype).astype(np.float64)
    flat = np.nan_to_num(flat, nan=0.0, posinf=0.0, neginf=0.0)
    _, place, counts = np.unique(flat, return_inverse=True, return_counts=True)
    rank = ((np.cumsum(counts) - 0.5 * counts) / len(flat))[place]
    lag = layout.fields + shift
    apart = np.abs(rank[lag:] - rank[:-lag])
    return float(np.mean(apart) - np.mean(apart == 0.0))  # many fields hold the same throughout
