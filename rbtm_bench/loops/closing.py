"""Loops by a pose graph: candidates, each verified, then all edges together, in rounds."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import pairwise

import numpy as np

from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array
from rbtm_bench.core.uncertainty import odometry_covariance
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.graph.optimise import optimise
from rbtm_bench.graph.pose_graph import PoseGraph
from rbtm_bench.loops.base import Closing, Loops, Route
from rbtm_bench.loops.certainty import Certainty
from rbtm_bench.loops.track import Places, Track
from rbtm_bench.loops.verify import Limits, Loop, Pair, Verifier
from rbtm_bench.odometry.method import Work


class GraphLoops(Loops):
    """Keyframes (``keyframe_distance`` m or ``keyframe_angle_deg`` apart) that may see a place
    again, more than ``apart_m`` m of path later, are registered and held against ``verify``. A
    pose graph of all edges of the run, of odometry between keyframes and of the loops that are
    believed, which ``phi`` scales down where they disagree (dynamic covariance scaling), gives the
    poses. So ``rounds`` times: from better poses more loops are met. A plug-in writes ``pairs``.
    """

    def __init__(
        self,
        keyframe_distance: float,
        keyframe_angle_deg: float,
        apart_m: float,
        phi: float,
        rounds: int,
        verify: Limits | None,
    ) -> None:
        self.keyframe_distance, self.keyframe_angle_deg = keyframe_distance, keyframe_angle_deg
        self.apart_m, self.phi, self.rounds = apart_m, phi, rounds
        self._limits = verify or Limits()
        self.covariance_from = self._limits.information

    @abstractmethod
    def pairs(
        self, track: Track, T_world_scan: Array, tried: Collection[Pair], closed: Places
    ) -> list[Pair]:
        """Pairs of keyframes to verify, none of them ``tried``, of each scan the best first: the
        model the older one. ``T_world_scan`` (K, 4, 4) are the best poses of the keyframes so far,
        ``closed`` (L,) the keyframes at an end of a loop that is believed."""

    def prepare(self, track: Track, dataset: Dataset, work: Work) -> None:
        """Called once a run, before the first ``pairs``."""

    def close(self, route: Route, dataset: Dataset, work: Work) -> Closing:
        started = time.perf_counter()
        planar = dataset.planar
        track = Track(route, planar, self.keyframe_distance, self.keyframe_angle_deg)
        self.prepare(track, dataset, work)
        verifier = Verifier(self._limits, track, dataset, work)
        loops: dict[Pair, Loop] = {}
        tried: dict[Pair, None] = {}
        best = graph_of(track, dataset, ())
        scale = np.ones(len(best.ends))
        for _ in range(self.rounds):
            before = len(loops)
            for pair, T_path, unsure in self._open(track, best, scale, loops, tried, verifier):
                tried[pair] = None
                outcome = verifier.verified(pair, T_path, unsure)
                if isinstance(outcome, Loop):
                    loops[pair] = outcome
            if len(loops) == before:
                break
            optimum = optimise(graph_of(track, dataset, list(loops.values())), self.phi)
            best, scale = optimum.graph, optimum.scale
        seconds = time.perf_counter() - started + verifier.reused_seconds
        off = int(np.count_nonzero(scale[best.may_be_wrong] < 0.5))
        rejected = len(tried) - len(loops)
        return Closing(best.T_world_scan, best, len(tried), len(loops), rejected, off, seconds)

    def _open(
        self,
        track: Track,
        best: PoseGraph,
        scale: Array,
        loops: Mapping[Pair, Loop],
        tried: Collection[Pair],
        verifier: Verifier,
    ) -> Iterator[tuple[Pair, Array, Array]]:
        """The pairs to look at with the poses so far, at most one a scan: those whose motion is
        known well enough for a search to reach what it may be. The others wait for better poses.
        """
        poses = best.T_world_scan[track.keyframes]
        counted = scale[best.may_be_wrong] >= 0.5
        believed = [loop for loop, counts in zip(loops.values(), counted, strict=True) if counts]
        closed = np.unique(np.array(list(loops), dtype=np.int64))
        done = {pair.scan for pair in loops}
        pairs = [p for p in self.pairs(track, poses, tried, closed) if p.scan not in done]
        covariances = Certainty(track, poses, believed).between(pairs)
        for pair, unsure in zip(pairs, covariances, strict=True):
            if pair.scan not in done and verifier.reaches(unsure):
                done.add(pair.scan)
                yield pair, inverse(poses[pair.model]) @ poses[pair.scan], unsure


def graph_of(track: Track, dataset: Dataset, loops: Sequence[Loop]) -> PoseGraph:
    """The graph of a run's edges and of loops; with loops also of odometry between keyframes,
    where it is known. At the odometry's poses."""
    ends, motions, covariances = list(track.ends), [e.T_model_scan for e in track.edges], []
    if loops:
        for model, scan, T in _wheels(track, dataset):
            ends.append(np.array([model, scan]))
            motions.append(T)
            covariances.append(odometry_covariance(T, track.planar))
    certain = len(ends)
    for loop in loops:
        ends.append(track.keyframes[[loop.pair.model, loop.pair.scan]])
        motions.append(loop.T_model_scan)
        covariances.append(loop.covariance)
    free = np.ix_(range(len(ends)), track.axes, track.axes)
    stacked = np.concatenate([track.covariances, np.array(covariances).reshape(-1, 6, 6)])
    information = np.zeros((len(ends), 6, 6))
    information[free] = np.linalg.inv(stacked[free])
    return PoseGraph(
        track.scans,
        track.T_world_scan,
        np.array(ends, dtype=np.int64).reshape(-1, 2),
        np.array(motions).reshape(-1, 4, 4),
        information,
        np.arange(len(ends)) >= certain,
        track.planar,
    )


def _wheels(track: Track, dataset: Dataset) -> list[tuple[int, int, Array]]:
    """The odometry's motion from each keyframe to the next, by place, where it is known."""
    numbers = track.scans[track.keyframes]
    known = [dataset[int(number)].odometry for number in numbers]
    return [
        (int(track.keyframes[k]), int(track.keyframes[k + 1]), inverse(one) @ other)
        for k, (one, other) in enumerate(pairwise(known))
        if one is not None and other is not None
    ]
