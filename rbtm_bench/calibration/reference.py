"""Motions known between scans of a log that has relations, and no pose a scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.calibration.track import Track
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.association import nearest
from rbtm_bench.datasets.base import Relations

Index = NDArray[np.intp]

TOLERANCE_S = 1e-4
"""s between a relation's end and the stamp of the scan that it means."""
WHEELS_M = 1e-3
"""m; a local relation that is nearer to odometry than this is taken for a copy of it."""
LOCAL_S = 30.0
"""s; ends further apart in time belong to two visits of a place."""


@dataclass(frozen=True, eq=False)
class Known:
    """Motions (K, 4, 4) known between scans ``target`` (the earlier) and ``source`` (K,).

    ``links``: of how many relations each is made; ``local``: its ends are at most 30 s apart.
    ``unmatched`` relations mean no scan, or one and the same twice; those ``of_wheels`` (of any
    that mean two) are left out.
    """

    target: Index
    source: Index
    T_target_source: Array
    links: Index
    local: NDArray[np.bool_]
    unmatched: int = 0
    of_wheels: int = 0


def of_wheels(track: Track, relations: Relations) -> NDArray[np.bool_]:
    """(R,) the local relations whose translation is that of wheel odometry to a millimetre: they
    were copied from it, and reward a method that copies it as well."""
    equal = np.zeros(len(relations), bool)
    if track.odometry is None:
        return equal
    i = nearest(track.stamps, relations.start, TOLERANCE_S)
    j = nearest(track.stamps, relations.end, TOLERANCE_S)
    near = (i >= 0) & (j >= 0) & (np.abs(relations.end - relations.start) <= LOCAL_S)
    moved = inverse(track.odometry[i[near]]) @ track.odometry[j[near]]
    off = moved[:, :3, 3] - relations.T_start_end[near, :3, 3]
    equal[near] = np.linalg.norm(off, axis=1) <= WHEELS_M
    return equal


def known_motions(track: Track, relations: Relations, chain: int) -> Known:
    """The relations as pairs of scans, and up to ``chain`` local ones in a row as one.

    Relations of a log mostly span one short distance; where the end of one is the start of the
    next, their product is a known motion over a larger gap, with the errors of all of them.
    """
    i = nearest(track.stamps, relations.start, TOLERANCE_S)
    j = nearest(track.stamps, relations.end, TOLERANCE_S)
    T = relations.T_start_end
    fits = (i >= 0) & (j >= 0) & (i != j)
    unmatched = int((~fits).sum())
    wheels = fits & of_wheels(track, relations)
    fits &= ~wheels
    i, j, T = i[fits], j[fits], T[fits]
    backwards = j < i  # scans of a file are not always in the order of time
    T = np.where(backwards[:, None, None], inverse(T), T)
    i, j = np.minimum(i, j), np.maximum(i, j)
    local = np.abs(track.stamps[j] - track.stamps[i]) <= LOCAL_S
    order = np.lexsort((j, i))
    i, j, T, local = i[order], j[order], T[order], local[order]
    chains = [(i, j, T, np.ones(len(i), np.intp))]
    chains += _chained(i[local], j[local], T[local], chain)
    target, source, motion, links = (np.concatenate(part) for part in zip(*chains, strict=True))
    near = np.abs(track.stamps[source] - track.stamps[target]) <= LOCAL_S
    first = links == 1
    keep = near | first  # a chain that lasts longer than a local relation is dropped
    return Known(
        target[keep],
        source[keep],
        motion[keep],
        links[keep],
        near[keep],
        unmatched,
        int(wheels.sum()),
    )


def _chained(i: Index, j: Index, T: Array, chain: int) -> list[tuple[Index, Index, Array, Index]]:
    """Products of 2 ... ``chain`` relations in a row; of several that start at one scan the
    first goes on."""
    chains: list[tuple[Index, Index, Array, Index]] = []
    if len(i) == 0:
        return chains
    starts, first = np.unique(i, return_index=True)
    end, motion, start = j, T, i
    for links in range(2, chain + 1):
        place = np.searchsorted(starts, end)
        place[place == len(starts)] = 0
        goes_on = starts[place] == end
        follows = first[place[goes_on]]
        start, motion, end = start[goes_on], motion[goes_on] @ T[follows], j[follows]
        chains.append((start, end, motion, np.full(len(start), links, np.intp)))
    return chains
