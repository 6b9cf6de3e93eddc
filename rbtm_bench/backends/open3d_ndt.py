"""Normal distributions transform in space (after Takeuchi and Tsubouchi 2006) by Open3D."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt, Lt

from rbtm_bench.backends.base import Alignment, Backend, Prepared
from rbtm_bench.backends.open3d_icp import cloud
from rbtm_bench.core.kinds import Distance, VoxelSize
from rbtm_bench.core.open3d_library import open3d
from rbtm_bench.core.types import Array

Positive = Annotated[float, Gt(0)]

DEGREES_OF_FREEDOM = 6
"""With fewer residuals Open3D stops where it is."""


class Open3DNDT(Backend):
    """``open3d.pipelines.registration.registration_ndt`` (MIT licence, Open3D 0.20 or later).

    Parameters: ``cell_size`` (m), the voxels of the target, each a Gaussian if it holds at least
    ``min_points``; ``eigenvalue_ratio``, the least of its eigenvalues to the largest;
    ``outlier_threshold``, the largest squared Mahalanobis distance of a pair of point and cell;
    ``face_neighbours``, whether a point is compared with the six voxels around its own too;
    ``max_iterations``; ``transformation_epsilon`` (norm of the last update, m and rad) and
    ``relative_objective`` (its relative change), below which Open3D stops.

    What differs from Takeuchi and Tsubouchi, and from Magnusson 2009: it minimises the mean of
    squared Mahalanobis distances by Gauss-Newton, where they maximise a sum of exp(-d^2/2) by
    Newton; a pair beyond the threshold does not count at all, so the objective has jumps; cells
    do not overlap (a point meets up to seven instead), and their size stays the same from far to
    near; steps are neither checked nor shortened. Every pair also pulls along the wall, to the
    middle of its cell: in corridors it sticks as point-to-point ICP does.

    ``max_correspondence_distance`` is the evaluator's radius only. Planar scans need no help: cells
    are centred on z = 0, and ``eigenvalue_ratio`` gives them a thickness. Open3D builds the cells
    in every call, so a registration pays for the target. ``converged`` is False if fewer than six
    points lie near a cell (Open3D then hands back its guess), else None: Open3D does not say, nor
    how many iterations it took, and its Hessian stays inside. Repeatable on one core only.
    """

    requires = ("open3d",)
    library = "Open3D (MIT)"
    repeats = "same bits on one core only (`pin=true`)"
    converged_means = "not reported; False where fewer than 6 points lie near a cell"
    self_tolerance = 2e-3  # points are compared with the means of cells

    def __init__(
        self,
        max_correspondence_distance: Distance = 0.3,
        voxel_size: VoxelSize = 0.0,
        cell_size: Distance = 1.0,
        min_points: Annotated[int, Ge(4)] = 6,
        eigenvalue_ratio: Annotated[float, Gt(0), Lt(1)] = 1e-3,
        outlier_threshold: Positive = 9.0,
        face_neighbours: bool = True,
        max_iterations: Annotated[int, Ge(1)] = 50,
        transformation_epsilon: Positive = 1e-6,
        relative_objective: Positive = 1e-6,
    ) -> None:
        super().__init__(max_correspondence_distance, voxel_size)
        o3d = open3d()

        self._option = o3d.pipelines.registration.NormalDistributionsTransformOption(
            voxel_size=cell_size,
            min_points_per_voxel=min_points,
            covariance_regularization=eigenvalue_ratio,
            transformation_epsilon=transformation_epsilon,
            relative_objective=relative_objective,
            max_iteration=max_iterations,
            outlier_threshold=outlier_threshold,
            neighbor_search_type=int(face_neighbours),
        )

    def build(self, points: Array, planar: bool) -> Any:
        return cloud(points)

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        o3d = open3d()

        # what it would print, scan by scan, is in `converged`
        with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
            result = o3d.pipelines.registration.registration_ndt(
                source.native, target.native, self._option, T_target_source
            )
        return Alignment(
            np.asarray(result.transformation),
            converged=False if len(result.correspondence_set) < DEGREES_OF_FREEDOM else None,
            library_fitness=result.fitness,
            library_rmse=result.inlier_rmse,
        )
