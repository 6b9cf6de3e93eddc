"""Point-to-point ICP (Besl and McKay 1992) by Open3D."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from rbtm_bench.backends.open3d_icp import Open3DICP, _registration, cloud
from rbtm_bench.core.open3d_library import open3d
from rbtm_bench.core.types import Array


@dataclass(eq=False)
class Open3DPointToPoint(Open3DICP):
    """``registration_icp`` with ``TransformationEstimationPointToPoint``.

    Open3D's point-to-point estimation takes no robust kernel. With one, the same residuals go
    through its generalized-ICP estimation with covariances of I/2 on both sides, which make its
    residuals plain differences in m. Open3D weighs each coordinate of them by itself, so with a
    kernel the result depends a little on how the sensor's axes lie.
    """

    def build(self, points: Array, planar: bool) -> Any:
        o3d = open3d()

        pcd = cloud(points)
        if self.kernel != "none":
            halves = np.tile(0.5 * np.eye(3), (len(points), 1, 1))
            pcd.covariances = o3d.utility.Matrix3dVector(halves)
        return pcd

    def icp(self, source: Any, target: Any, distance: float, guess: Array) -> Any:
        registration = _registration()
        if self.kernel == "none":
            estimation = registration.TransformationEstimationPointToPoint(False)
            return registration.registration_icp(
                source, target, distance, guess, estimation, self.criteria
            )
        estimation = registration.TransformationEstimationForGeneralizedICP(
            1.0, self.robust_kernel()
        )
        return registration.registration_generalized_icp(
            source, target, distance, guess, estimation, self.criteria
        )
