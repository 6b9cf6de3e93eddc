"""Candidates by similarity: what looks like a place of long ago, wherever the path says it is."""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt
from scipy.spatial import cKDTree

from rbtm_bench.core.kinds import Distance, Threshold
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.loops.closing import GraphLoops
from rbtm_bench.loops.track import Places, Track
from rbtm_bench.loops.verify import Limits, Pair
from rbtm_bench.odometry import checked
from rbtm_bench.odometry.method import Work
from rbtm_bench.similarity.base import Descriptor, checked_scores


class SimilarityLoops(GraphLoops):
    """For every keyframe the most similar older one with S > ``threshold``, of the ``nearest``
    neighbours of its descriptor.

    Descriptors, reduced to their ``components`` principal ones, stand in a k-d tree, so that a
    keyframe is compared with few of all before it; those few by the similarity itself. One that
    compares under a guess has no such descriptors and is refused. Other parameters as in
    ``GraphLoops``.
    """

    needs_scores = True

    def __init__(
        self,
        threshold: Threshold = 0.7,
        nearest: Annotated[int, Ge(1)] = 50,
        components: Annotated[int, Ge(1)] = 16,
        keyframe_distance: Distance = 0.5,
        keyframe_angle_deg: Annotated[float, Gt(0)] = 15.0,
        apart_m: Annotated[float, Gt(0)] = 10.0,
        phi: Annotated[float, Gt(0)] = 5.0,
        rounds: Annotated[int, Ge(1)] = 10,
        verify: Limits | None = None,
    ) -> None:
        super().__init__(keyframe_distance, keyframe_angle_deg, apart_m, phi, rounds, verify)
        self.threshold, self.nearest, self.components = threshold, nearest, components

    def prepare(self, track: Track, dataset: Dataset, work: Work) -> None:
        self._similarity = work.method.similarity
        numbers = track.scans[track.keyframes].tolist()
        scans = [dataset[number] for number in numbers]
        self._descriptors = checked.descriptors(self._similarity, scans)
        self._places = principal(self._descriptors, self.components)

    def pairs(
        self, track: Track, T_world_scan: Array, tried: Collection[Pair], closed: Places
    ) -> list[Pair]:
        count = min(self.nearest + 1, len(self._places))
        _, near = cKDTree(self._places).query(self._places, k=count)
        pairs = []
        for scan, row in enumerate(near.reshape(len(near), -1)):
            models = np.sort(row)
            models = models[track.path[scan] - track.path[models] > self.apart_m]
            models = models[[Pair(int(model), scan) not in tried for model in models]]
            if not len(models):
                continue
            scores = self._similarity.scores(self._descriptors[models], self._descriptors[scan])
            scores = checked_scores(self._similarity, scores, (len(models),))
            scores = np.where(scores > self.threshold, scores, -np.inf)  # NaN never passes
            best = int(scores.argmax())
            if np.isfinite(scores[best]):
                pairs.append(Pair(int(models[best]), scan))
        return pairs


def principal(descriptors: Descriptor, components: int) -> Array:
    """Descriptors (N, D), real or complex, by their first principal components (N, at most
    ``components``): what is not finite counts as 0."""
    parts = [descriptors.real, descriptors.imag] if descriptors.dtype.kind == "c" else [descriptors]
    X = np.nan_to_num(np.hstack(parts).astype(np.float64), posinf=0.0, neginf=0.0)
    X = X - X.mean(axis=0)
    _, vectors = np.linalg.eigh(X.T @ X)
    return X @ vectors[:, ::-1][:, :components]
