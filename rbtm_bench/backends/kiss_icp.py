"""KISS-ICP's registration (Vizzo et al. 2023) of a scan to a voxel map of the model scan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt

from rbtm_bench.backends.base import Alignment, Backend, Prepared
from rbtm_bench.core.kinds import Distance, VoxelSize
from rbtm_bench.core.types import Array

Positive = Annotated[float, Gt(0)]


@dataclass(frozen=True, eq=False)
class VoxelMap:
    """KISS-ICP's hash map of a scan, and the points it kept: those are the source's points, so
    that a scan meets itself exactly."""

    map: Any
    kept: Array


class KissICP(Backend):
    """``kiss_icp.registration.Registration.align_points_to_map`` (MIT licence).

    Point-to-point with a Geman-McClure-like kernel of ``kernel`` m (default: a third of the
    correspondence distance, KISS-ICP's own ratio). ``map_voxel_size`` m is the map's voxel
    (default: the correspondence distance, since the map is searched one voxel around a point) and
    ``max_points_per_voxel`` its density (KISS-ICP itself uses 20; with 100 a 2D scan in 0.3 m
    voxels keeps enough points for millimetres). To fill the map from the model scan and its
    neighbours, choose ``target=local_map``. The library gives only a pose (its guess, where nothing
    corresponds): ``converged`` is False without inliers, else None.
    """

    requires = ("kiss_icp",)
    library = "KISS-ICP (MIT)"
    repeats = "same bits; one thread, the library's limit"

    def __init__(
        self,
        max_correspondence_distance: Distance = 0.3,
        voxel_size: VoxelSize = 0.0,
        kernel: Positive | None = None,
        map_voxel_size: Distance | None = None,
        max_points_per_voxel: Annotated[int, Ge(1)] = 100,
        max_iterations: Annotated[int, Ge(1)] = 500,
        convergence_criterion: Positive = 1e-4,
        max_range: Positive = 200.0,
    ) -> None:
        super().__init__(max_correspondence_distance, voxel_size)
        from kiss_icp.registration import Registration

        self.kernel = kernel or max_correspondence_distance / 3.0
        self.map_voxel_size = map_voxel_size or max_correspondence_distance
        self.max_points_per_voxel = max_points_per_voxel
        self.max_range = max_range
        # the thread limit is global to the process and the first value wins: always one
        self._registration = Registration(
            max_num_iterations=max_iterations,
            convergence_criterion=convergence_criterion,
            max_num_threads=1,
        )

    def build(self, points: Array, planar: bool) -> VoxelMap:
        from kiss_icp.mapping import VoxelHashMap

        voxels = VoxelHashMap(self.map_voxel_size, self.max_range, self.max_points_per_voxel)
        voxels.add_points(points)
        return VoxelMap(voxels, np.array(voxels.point_cloud()))

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        T = self._registration.align_points_to_map(
            points=source.native.kept,
            voxel_map=target.native.map,
            initial_guess=T_target_source,
            max_correspondance_distance=self.max_correspondence_distance,
            kernel=self.kernel,
        )
        return Alignment(np.asarray(T))
