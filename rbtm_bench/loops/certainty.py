"""How sure the motions between keyframes are, given the path and the loops believed so far."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.sparse.linalg import splu

from rbtm_bench.core.geometry import adjoint, inverse, symmetric
from rbtm_bench.core.types import Array
from rbtm_bench.graph.optimise import normal_equations
from rbtm_bench.graph.pose_graph import PoseGraph
from rbtm_bench.loops.track import Track
from rbtm_bench.loops.verify import Loop, Pair

Blocks = dict[tuple[int, int], Array]
"""Of the inverse, by the keyframes of its rows and columns."""

COLUMNS = 300
"""Of the inverse, solved for at a time."""


class Certainty:
    """Covariances of motions between keyframes at their best poses ``T_world_keyframe`` (K, 4, 4):
    of the path from one to the next, and of the ``loops`` that count (marginals of the pose graph
    of keyframes alone)."""

    def __init__(self, track: Track, T_world_keyframe: Array, loops: Sequence[Loop]) -> None:
        self._track, self._poses, self._loops = track, T_world_keyframe, loops

    def between(self, pairs: Sequence[Pair]) -> list[Array]:
        """The covariance (6, 6) of each pair's motion T_model_scan, of a small motion of the scan
        in its own frame: the smaller of what the path alone and what the graph says."""
        keyframes = self._track.keyframes
        by_path = [
            self._track.between(int(keyframes[pair.model]), int(keyframes[pair.scan]))[1]
            for pair in pairs
        ]
        if not self._loops or not pairs:
            return by_path
        by_graph = self._marginals(pairs)
        both = zip(by_path, by_graph, strict=True)
        return [min(one, key=lambda covariance: float(np.trace(covariance))) for one in both]

    def _marginals(self, pairs: Sequence[Pair]) -> list[Array]:
        graph, axes = self.graph(), self._track.axes
        size = len(axes)
        H, _ = normal_equations(graph, np.ones(len(graph.ends)))
        solver = splu(H.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        count, nodes = H.shape[0], sorted({node for pair in pairs for node in pair} - {0})
        rows = {node: {node} for node in nodes}
        for pair in pairs:  # of the first keyframe, which is held, there are none
            rows[pair.scan] |= {pair.model} - {0}
        blocks: Blocks = {}
        for start in range(0, len(nodes), COLUMNS // size):
            part = nodes[start : start + COLUMNS // size]
            unit = np.zeros((count, size * len(part)))
            for k, node in enumerate(part):
                at = (node - 1) * size  # the first keyframe is held
                unit[at : at + size, k * size : (k + 1) * size] = np.eye(size)
            solved = solver.solve(unit)
            for k, node in enumerate(part):
                for row in rows[node]:
                    at = (row - 1) * size
                    blocks[row, node] = solved[at : at + size, k * size : (k + 1) * size]
        return [self._of_motion(pair, blocks, axes) for pair in pairs]

    def _of_motion(self, pair: Pair, blocks: Blocks, axes: list[int]) -> Array:
        """d of T_model_scan exp(d) is the scan's small motion less the model's, moved into the
        scan's frame."""
        T_model_scan = inverse(self._poses[pair.model]) @ self._poses[pair.scan]
        A = adjoint(inverse(T_model_scan))[np.ix_(axes, axes)]
        none = np.zeros((len(axes), len(axes)))
        of_model = blocks.get((pair.model, pair.model), none)
        joint = A @ blocks.get((pair.model, pair.scan), none)
        covariance = np.zeros((6, 6))
        own = blocks.get((pair.scan, pair.scan), none) - joint - joint.T + A @ of_model @ A.T
        covariance[np.ix_(axes, axes)] = symmetric(own)
        return covariance

    def graph(self) -> PoseGraph:
        """The keyframes, the path from each to the next, and the loops."""
        track, axes = self._track, self._track.axes
        hops = [track.between(int(a), int(b)) for a, b in pairwise(track.keyframes)]
        ends = [(k, k + 1) for k in range(len(hops))]
        ends += [(loop.pair.model, loop.pair.scan) for loop in self._loops]
        motions = [T for T, _ in hops] + [loop.T_model_scan for loop in self._loops]
        covariances = [c for _, c in hops] + [loop.covariance for loop in self._loops]
        free = np.ix_(range(len(ends)), axes, axes)
        information = np.zeros((len(ends), 6, 6))
        information[free] = np.linalg.inv(np.array(covariances)[free])
        return PoseGraph(
            track.scans[track.keyframes],
            self._poses,
            np.array(ends, dtype=np.int64),
            np.array(motions),
            information,
            np.zeros(len(ends), dtype=bool),
            track.planar,
        )
