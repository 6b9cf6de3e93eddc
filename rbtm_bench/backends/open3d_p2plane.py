"""Point-to-plane ICP (Chen and Medioni 1992) by Open3D; point-to-line on planar scans."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from annotated_types import Ge

from rbtm_bench.backends.open3d_icp import Kernel, Open3DICP, Positive, _registration, cloud
from rbtm_bench.backends.planar import normals_2d
from rbtm_bench.types import Array


class Open3DPointToPlane(Open3DICP):
    """``registration_icp`` with ``TransformationEstimationPointToPlane``.

    Normals come from the neighbours within ``normal_radius`` m (default: the correspondence
    distance), at most ``normal_neighbours``; in the plane for planar scans.
    """

    def __init__(
        self,
        max_correspondence_distance: Positive = 0.3,
        voxel_size: Annotated[float, Ge(0)] = 0.0,
        max_iterations: Annotated[int, Ge(1)] = 50,
        relative_fitness: Positive = 1e-6,
        relative_rmse: Positive = 1e-6,
        kernel: Kernel = "none",
        kernel_scale: Positive = 0.1,
        coarse_to_fine: Sequence[Positive] = (1.0,),
        normal_radius: Positive | None = None,
        normal_neighbours: Annotated[int, Ge(5)] = 30,
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
        )
        self.normal_radius = normal_radius or max_correspondence_distance
        self.normal_neighbours = normal_neighbours

    def build(self, points: Array, planar: bool) -> Any:
        import open3d as o3d

        pcd = cloud(points)
        if planar:
            normals = normals_2d(points, self.normal_radius, self.normal_neighbours)
            pcd.normals = o3d.utility.Vector3dVector(normals)
        else:
            pcd.estimate_normals(
                o3d.geometry.KDTreeSearchParamHybrid(self.normal_radius, self.normal_neighbours)
            )
        return pcd

    def icp(self, source: Any, target: Any, distance: float, guess: Array) -> Any:
        registration = _registration()
        return registration.registration_icp(
            source,
            target,
            distance,
            guess,
            registration.TransformationEstimationPointToPlane(self.robust_kernel()),
            self._criteria,
        )
