"""Generalized ICP (Segal, Haehnel and Thrun 2009) by Open3D."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge

from rbtm_bench.backends.open3d_icp import Kernel, Positive, _registration
from rbtm_bench.backends.open3d_p2plane import Open3DPointToPlane
from rbtm_bench.backends.planar import covariances_2d
from rbtm_bench.types import Array


class Open3DGeneralizedICP(Open3DPointToPlane):
    """``registration_generalized_icp``; each point a small disc of thickness ``epsilon``.

    The covariances follow from the normals of ``Open3DPointToPlane``, whose parameters it takes
    too. With a kernel, ``kernel_scale`` weighs Mahalanobis distances (each coordinate by itself),
    which for neighbours on one wall are about the metric distance across the wall over
    sqrt(2 epsilon).
    """

    def __init__(
        self,
        max_correspondence_distance: Positive = 0.3,
        voxel_size: Annotated[float, Ge(0)] = 0.0,
        max_iterations: Annotated[int, Ge(1)] = 50,
        relative_fitness: Positive = 1e-6,
        relative_rmse: Positive = 1e-6,
        kernel: Kernel = "none",
        kernel_scale: Positive = 1.0,
        coarse_to_fine: Sequence[Positive] = (1.0,),
        normal_radius: Positive | None = None,
        normal_neighbours: Annotated[int, Ge(5)] = 30,
        epsilon: Positive = 1e-3,
    ) -> None:
        super().__init__(
            max_correspondence_distance,
            voxel_size,
            max_iterations,
            relative_fitness,
            relative_rmse,
            kernel,
            kernel_scale,
            coarse_to_fine,
            normal_radius,
            normal_neighbours,
        )
        self.epsilon = epsilon

    def build(self, points: Array, planar: bool) -> Any:
        import open3d as o3d

        pcd = super().build(points, planar)
        covariances = covariances_2d(np.asarray(pcd.normals), self.epsilon)
        pcd.covariances = o3d.utility.Matrix3dVector(covariances)
        return pcd

    def icp(self, source: Any, target: Any, distance: float, guess: Array) -> Any:
        registration = _registration()
        return registration.registration_generalized_icp(
            source,
            target,
            distance,
            guess,
            registration.TransformationEstimationForGeneralizedICP(
                self.epsilon, self.robust_kernel()
            ),
            self._criteria,
        )
