"""A pose graph: scans with poses, and measured motions between them that agree only nearly."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.types import Array
from rbtm_bench.core.uncertainty import PLANE, SPACE
from rbtm_bench.graph import motions


@dataclass(frozen=True, eq=False)
class PoseGraph:
    """``scans`` (N,) are the nodes' numbers and ``T_world_scan`` (N, 4, 4) their poses. Edge k is
    the motion ``T_model_scan`` (4, 4) between the nodes at the places ``ends[k]`` = (model, scan),
    with ``information`` (6, 6) of a small motion of the scan in its own frame in 1/m^2, 1/rad^2
    and between. ``may_be_wrong`` (E,) marks the edges, loops, that an optimiser may turn off.
    """

    scans: NDArray[np.int64]
    T_world_scan: Array
    ends: NDArray[np.int64]
    T_model_scan: Array
    information: Array
    may_be_wrong: NDArray[np.bool_]
    planar: bool

    def __post_init__(self) -> None:
        nodes, edges = len(self.scans), len(self.ends)
        shapes = {
            "scans": (nodes,),
            "T_world_scan": (nodes, 4, 4),
            "ends": (edges, 2),
            "T_model_scan": (edges, 4, 4),
            "information": (edges, 6, 6),
            "may_be_wrong": (edges,),
        }
        for name, shape in shapes.items():
            given = getattr(self, name).shape
            if given != shape:
                raise ValueError(f"{name} {given}: expected {shape}")
        if edges and not (self.ends.min() >= 0 and self.ends.max() < nodes):
            raise ValueError(f"an edge's end is none of {nodes} nodes")

    @property
    def axes(self) -> list[int]:
        """The components of a small motion that are free: x, y, rz in the plane."""
        return PLANE if self.planar else SPACE

    def at(self, T_world_scan: Array) -> PoseGraph:
        """The same graph with other poses."""
        return replace(self, T_world_scan=T_world_scan)

    def residuals(self) -> Array:
        """What each edge is off (E, D), along the free axes."""
        return self._whole_residuals()[:, self.axes]

    def linearised(self) -> tuple[Array, Array, Array]:
        """``residuals`` (E, D) and their derivatives (E, D, D) by the model's and the scan's small
        motion along the free axes."""
        e, free = self._whole_residuals(), np.ix_(range(len(self.ends)), self.axes, self.axes)
        by_model, by_scan = motions.jacobians(self.T_model_scan, e)
        return e[:, self.axes], by_model[free], by_scan[free]

    def weights(self) -> Array:
        """``information`` (E, D, D) along the free axes."""
        return self.information[np.ix_(range(len(self.ends)), self.axes, self.axes)]

    def _whole_residuals(self) -> Array:
        model, scan = self.ends.T
        return motions.residuals(
            self.T_world_scan[model], self.T_world_scan[scan], self.T_model_scan
        )
