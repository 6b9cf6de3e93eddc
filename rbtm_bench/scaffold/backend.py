"""A registration method: prepare a scan once, align many pairs."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import open3d as o3d
from annotated_types import Ge

from rbtm_bench.backends.base import Alignment, Backend, Prepared
from rbtm_bench.core.kinds import Distance, VoxelSize
from rbtm_bench.core.types import Array


class NewBackend(Backend):
    """Open3D's point-to-point ICP, to be replaced by your library."""

    requires = ("open3d",)  # packages: without them `list` says so and tests are skipped

    def __init__(
        self,
        max_correspondence_distance: Distance = 0.3,
        voxel_size: VoxelSize = 0.0,
        rounds: Annotated[int, Ge(1)] = 50,
    ) -> None:
        super().__init__(max_correspondence_distance, voxel_size)
        self.criteria = o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=rounds)

    def build(self, points: Array, planar: bool) -> Any:
        """Once a scan: points (N, 3) m into whatever ``align`` needs."""
        return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        """Once a pair, from the initial guess (4, 4)."""
        result = o3d.pipelines.registration.registration_icp(
            source.native,
            target.native,
            self.max_correspondence_distance,
            T_target_source,
            criteria=self.criteria,
        )
        return Alignment(np.asarray(result.transformation), library_fitness=result.fitness)
