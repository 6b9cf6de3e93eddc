"""The path that a run has taken, as one who looks for loops sees it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.geometry import adjoint, inverse, rotation_angle, symmetric, translation_norm
from rbtm_bench.core.types import Array, Edge
from rbtm_bench.core.uncertainty import PLANE, SPACE, chained, edge_covariance, inflated
from rbtm_bench.loops.base import Route

Places = NDArray[np.int64]


class Track:
    """A run's steps by place, 0 to N - 1: ``scans`` (N,) are their numbers, ``T_world_scan``
    (N, 4, 4) the odometry's poses, ``edges`` all edges with inflated covariances, ``keyframes``
    (K,) the places ``distance`` m or ``angle_deg`` apart, and ``path`` (K,) the m between them so
    far."""

    def __init__(self, route: Route, planar: bool, distance: float, angle_deg: float) -> None:
        self.planar = planar
        self.scans = np.array(route.scans, dtype=np.int64)
        self.T_world_scan = np.stack(route.T_world_scan)
        self._place = {scan: i for i, scan in enumerate(self.scans.tolist())}
        self.edges = route.edges
        self.ends: Places = np.array(
            [(self._place[e.model], self._place[e.scan]) for e in self.edges], dtype=np.int64
        ).reshape(-1, 2)
        self.covariances = np.array([self._of_edge(edge) for edge in self.edges])
        self.keyframes = self._keyframes(distance, np.radians(angle_deg))
        hops = inverse(self.T_world_scan[self.keyframes[:-1]])
        hops = hops @ self.T_world_scan[self.keyframes[1:]]
        self.path = np.concatenate([[0.0], np.cumsum(translation_norm(hops))])
        self._chain()

    @property
    def axes(self) -> list[int]:
        """The components of a small motion that are free."""
        return PLANE if self.planar else SPACE

    def between(self, model: int, scan: int) -> tuple[Array, Array]:
        """The odometry's motion T_model_scan (4, 4) between two places, and its covariance (6, 6)
        along the chains that join them, of a small motion of the scan in its own frame."""
        a, b = model, scan
        while a != b:  # up to the last scan that both hang on: models are earlier than scans
            if a > b:
                a = int(self._model[a])
            else:
                b = int(self._model[b])
        T = inverse(self.T_world_scan[model]) @ self.T_world_scan[scan]
        return T, chained(self._since(a, model), T, self._since(a, scan))

    def _since(self, start: int, place: int) -> Array:
        """The covariance (6, 6) of the chain from a place to one that hangs on it."""
        A = adjoint(inverse(self.T_world_scan[place]) @ self.T_world_scan[start])
        return symmetric(self._behind[place] - A @ self._behind[start] @ A.T)

    def _of_edge(self, edge: Edge) -> Array:
        known = edge.covariance
        covariance = edge_covariance(None, self.planar) if known is None else known
        return inflated(covariance, edge.T_model_scan, self.planar)

    def _chain(self) -> None:
        """Which place each hangs on, by its first edge, and the covariance (N, 6, 6) behind it."""
        count = len(self.scans)
        self._model, self._behind = np.zeros(count, dtype=np.int64), np.zeros((count, 6, 6))
        seen = {0}
        for (model, scan), edge, own in zip(
            self.ends.tolist(), self.edges, self.covariances, strict=True
        ):
            if scan in seen:
                continue
            seen.add(scan)
            self._model[scan] = model
            self._behind[scan] = chained(self._behind[model], edge.T_model_scan, own)

    def _keyframes(self, distance: float, angle: float) -> Places:
        kept = [0]
        for place in range(1, len(self.scans)):
            T = inverse(self.T_world_scan[kept[-1]]) @ self.T_world_scan[place]
            if float(translation_norm(T)) >= distance or float(rotation_angle(T)) >= angle:
                kept.append(place)
        return np.array(kept, dtype=np.int64)
