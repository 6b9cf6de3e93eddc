"""Pose graphs in g2o's text format, in the plane (SE2) and in space (SE3:QUAT).

A vertex is a scan, by its number; the first is FIXed. Behind the comment ``# may be wrong`` stand
the edges that an optimiser may turn off; in files of others there is none. g2o's small rotation in
space is the vector part of a quaternion, half of ours, so information of turns is four times ours.

Source: Kuemmerle, Grisetti, Strasdat, Konolige, Burgard, "g2o: A general framework for graph
optimization", ICRA 2011; its wiki, "File format", and ``types_slam3d/edge_se3.cpp``.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.files import write_text
from rbtm_bench.core.geometry import se2, se3, yaw
from rbtm_bench.core.trajectory import QUATERNION_TOLERANCE
from rbtm_bench.core.types import Array
from rbtm_bench.core.uncertainty import PLANE, SPACE
from rbtm_bench.graph.pose_graph import PoseGraph

MAY_BE_WRONG = "# may be wrong"
TURNS = np.diag([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
"""Our small motion in space out of g2o's."""


class Kind(NamedTuple):
    """One of the two kinds of graph: tags of lines, and how many numbers a pose and the upper half
    of an information matrix have."""

    vertex: str
    edge: str
    pose: int
    information: int


KINDS = {
    True: Kind("VERTEX_SE2", "EDGE_SE2", 3, 6),
    False: Kind("VERTEX_SE3:QUAT", "EDGE_SE3:QUAT", 7, 21),
}


def write_g2o(path: str | os.PathLike[str], graph: PoseGraph) -> None:
    """Write a graph, whole or not at all: poses and edges come back to the last bits or two.
    Raises ``WriteError``."""
    write_text(Path(path), "\n".join([*_lines(graph), ""]))


def read_g2o(path: str | os.PathLike[str]) -> PoseGraph:
    """Read a graph; its first vertex is the one held.

    Raises ``DataError`` naming file and line for anything but vertices and edges of one kind, with
    poses that are finite, information that is positive semidefinite, and ends that exist.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise DataError(f"{path}: cannot be read: {reason}") from error
    return _Reader(path).read(text)


def _lines(graph: PoseGraph) -> Iterator[str]:
    kind = KINDS[graph.planar]
    for scan, T in zip(graph.scans.tolist(), graph.T_world_scan, strict=True):
        yield f"{kind.vertex} {scan} {_pose_words(T, graph.planar)}"
    if len(graph.scans):
        yield f"FIX {graph.scans[0]}"
    information = graph.weights()
    if not graph.planar:
        information = TURNS @ information @ TURNS
    upper = np.triu_indices(len(graph.axes))
    for wrong in (False, True):
        places = np.flatnonzero(graph.may_be_wrong == wrong)
        if wrong and len(places):
            yield MAY_BE_WRONG
        for k in places.tolist():
            model, scan = graph.scans[graph.ends[k]].tolist()
            motion = _pose_words(graph.T_model_scan[k], graph.planar)
            yield f"{kind.edge} {model} {scan} {motion} {_words(information[k][upper])}"


def _pose_words(T: Array, planar: bool) -> str:
    if planar:
        return _words(np.array([T[0, 3], T[1, 3], float(yaw(T))]))
    quaternion = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True)
    return _words(np.concatenate([T[:3, 3], quaternion]))


def _words(values: Array) -> str:
    return " ".join(map(repr, values.tolist()))


class _Reader:
    """One file on its way in."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path, self.number = path, 0
        self.planar: bool | None = None
        self.poses: dict[int, Array] = {}
        self.edges: list[tuple[int, int, int, Array, Array]] = []
        self.wrong: list[bool] = []

    def read(self, text: str) -> PoseGraph:
        is_wrong = False
        for number, line in enumerate(text.splitlines(), start=1):
            self.number = number
            words = line.split()
            is_wrong = is_wrong or line.strip() == MAY_BE_WRONG
            if not words or words[0].startswith("#"):
                continue
            if words[0] == "FIX":
                if len(words) < 2 or any(self._number_of(w) not in self.poses for w in words[1:]):
                    raise self._error("FIX", "the numbers of vertices above")
                continue
            self._take(words, is_wrong)
        return self._graph()

    def _take(self, words: list[str], is_wrong: bool) -> None:
        """One vertex or edge."""
        planar = {k.vertex: p for p, k in KINDS.items()} | {k.edge: p for p, k in KINDS.items()}
        tags = ", ".join(planar)
        if words[0] not in planar:
            raise self._error(words[0][:40], f"one of {tags}, FIX")
        if self.planar is not None and planar[words[0]] != self.planar:
            raise self._error(words[0], "vertices and edges of one kind, SE2 or SE3:QUAT")
        self.planar = planar[words[0]]
        kind = KINDS[self.planar]
        if words[0] == kind.vertex:
            self._require(words, 2 + kind.pose)
            scan = self._number_of(words[1])
            if scan in self.poses:
                raise self._error(f"vertex {scan}", "each vertex once")
            self.poses[scan] = self._pose(words[2:])
            return
        self._require(words, 3 + kind.pose + kind.information)
        ends = self._number_of(words[1]), self._number_of(words[2])
        T = self._pose(words[3 : 3 + kind.pose])
        self.edges.append((self.number, *ends, T, self._information(words[3 + kind.pose :])))
        self.wrong.append(is_wrong)

    def _graph(self) -> PoseGraph:
        if not self.poses:
            raise self._error("no vertex", "at least one")
        place = {scan: i for i, scan in enumerate(self.poses)}
        for number, model, scan, _, _ in self.edges:
            self.number = number
            if model not in place or scan not in place or model == scan:
                raise self._error(f"edge {model} -> {scan}", "two vertices of the file")
        ends = [(place[model], place[scan]) for _, model, scan, _, _ in self.edges]
        return PoseGraph(
            np.array(list(self.poses), dtype=np.int64),
            np.stack(list(self.poses.values())),
            np.array(ends, dtype=np.int64).reshape(-1, 2),
            np.array([edge[3] for edge in self.edges]).reshape(-1, 4, 4),
            np.array([edge[4] for edge in self.edges]).reshape(-1, 6, 6),
            np.array(self.wrong, dtype=bool),
            bool(self.planar),
        )

    def _error(self, what: str, expected: str) -> DataError:
        return DataError.at(self.path, self.number, what, expected)

    def _require(self, words: list[str], count: int) -> None:
        if len(words) != count:
            raise self._error(f"{words[0]} with {len(words)} words", str(count))

    def _number_of(self, word: str) -> int:
        if not (word.isascii() and word.isdigit() and len(word) < 19):
            raise self._error(f"vertex {word[:40]!r}", "a whole number")
        return int(word)

    def _values(self, words: list[str]) -> Array:
        try:
            values = np.array([float(word) for word in words])
        except ValueError:
            values = np.array([math.nan])
        if not np.isfinite(values).all():
            raise self._error("numbers", "finite ones")
        return values

    def _pose(self, words: list[str]) -> Array:
        values = self._values(words)
        if self.planar:
            return se2(*values.tolist())
        if abs(float(np.linalg.norm(values[3:])) - 1.0) > QUATERNION_TOLERANCE:
            raise self._error("quaternion", "norm 1")
        return se3(values[:3], Rotation.from_quat(values[3:]).as_matrix())

    def _information(self, words: list[str]) -> Array:
        axes = PLANE if self.planar else SPACE
        half = np.zeros((len(axes), len(axes)))
        half[np.triu_indices(len(axes))] = self._values(words)
        full = half + np.triu(half, 1).T
        if np.linalg.eigvalsh(full)[0] < -1e-9 * max(1.0, float(np.abs(full).max())):
            raise self._error("information", "a positive semidefinite matrix")
        if not self.planar:
            full = full / np.outer(np.diag(TURNS), np.diag(TURNS))
        out = np.zeros((6, 6))
        out[np.ix_(axes, axes)] = full
        return out
