"""Generalized ICP (Segal, Haehnel and Thrun 2009) by Open3D."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from rbtm_bench.backends.open3d_icp import Positive, _registration
from rbtm_bench.backends.open3d_p2plane import Open3DPointToPlane
from rbtm_bench.backends.planar import covariances_of_discs
from rbtm_bench.core.open3d_library import open3d
from rbtm_bench.core.types import Array


@dataclass(eq=False)
class Open3DGeneralizedICP(Open3DPointToPlane):
    """``registration_generalized_icp``; each point a small disc of thickness ``epsilon``.

    The covariances follow from the normals of ``Open3DPointToPlane``, whose parameters it takes
    too. With a kernel, ``kernel_scale`` weighs Mahalanobis distances (each coordinate by itself),
    which for neighbours on one wall are about the metric distance across the wall over
    sqrt(2 epsilon).
    """

    kernel_scale: Positive = 1.0
    epsilon: Positive = 1e-3

    def build(self, points: Array, planar: bool) -> Any:
        o3d = open3d()

        pcd = super().build(points, planar)
        covariances = covariances_of_discs(np.asarray(pcd.normals), self.epsilon)
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
            self.criteria,
        )
