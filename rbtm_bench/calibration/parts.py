"""The cut between calibration and report, and what is resampled together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.types import Array
from rbtm_bench.report import intervals

Index = NDArray[np.intp]

CALIBRATION, REPORTED = "calibration", "reported"
PARTS = (CALIBRATION, REPORTED)

BLOCK_S = 30.0
"""s; pairs whose middles fall into one block of this length are resampled together."""
BLOCKS = 8
"""A part of at least so many blocks: of a shorter log they are shorter."""


def parts_of(known: NDArray[np.bool_]) -> Index:
    """The part (N,) of every scan: 0 calibration, the first half of those with a known pose in the
    order that they are run in, 1 reported, the others; -1 without a known pose."""
    part = np.full(len(known), -1, np.intp)
    inside = np.flatnonzero(known)
    part[inside] = np.arange(len(inside)) >= (len(inside) + 1) // 2
    return part


def span_of(part: Index, number: int) -> tuple[int, int]:
    """The scans of a part as the first and the one behind its last."""
    inside = np.flatnonzero(part == number)
    return int(inside[0]), int(inside[-1]) + 1


def evenly(count: int, at_most: int) -> Index:
    """At most so many of ``count`` positions, spread evenly."""
    if count <= at_most:
        return np.arange(count)
    return np.linspace(0, count - 1, at_most).round().astype(np.intp)


def clusters_of(
    stamps: Array, target: Index, source: Index, revisit: NDArray[np.bool_]
) -> tuple[Index, float]:
    """What is resampled together (K,), and the length of its blocks in s.

    Pairs across gaps: blocks of 30 s by the pair's middle, shorter where a part would have less
    than 8. Revisits: place and time, as the long relations of ``rbtm_bench.report.intervals``.
    """
    start, end = stamps[target], stamps[source]
    span = float(np.ptp(stamps)) / 2
    block_s = min(BLOCK_S, span / BLOCKS) if span > 0 else BLOCK_S
    labels = np.zeros(len(target), np.intp)
    labels[~revisit] = np.floor((0.5 * (start + end)[~revisit] - stamps.min()) / block_s)
    if revisit.any():
        nothing = np.zeros(int(revisit.sum()), bool)
        again = intervals.relation_clusters(start[revisit], end[revisit], nothing)
        labels[revisit] = again + labels.max(initial=0) + 1
    return labels, block_s
