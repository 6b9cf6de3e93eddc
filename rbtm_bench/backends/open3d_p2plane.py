"""Point-to-plane ICP (Chen and Medioni 1992) by Open3D; point-to-line on planar scans."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge

from rbtm_bench.backends.open3d_icp import Open3DICP, _registration, cloud
from rbtm_bench.backends.planar import normals_2d
from rbtm_bench.core.kinds import Distance
from rbtm_bench.core.open3d_library import open3d
from rbtm_bench.core.types import Array


@dataclass(eq=False)
class Open3DPointToPlane(Open3DICP):
    """``registration_icp`` with ``TransformationEstimationPointToPlane``.

    Normals come from the neighbours within ``normal_radius`` m (default: the correspondence
    distance), at most ``normal_neighbours``; in the plane for planar scans.
    """

    normal_radius: Distance | None = None
    normal_neighbours: Annotated[int, Ge(5)] = 30

    def __post_init__(self) -> None:
        super().__post_init__()
        normals_2d(np.eye(3), 1.0, self.normal_neighbours)  # compiles its kernels

    def build(self, points: Array, planar: bool) -> Any:
        o3d = open3d()

        pcd = cloud(points)
        radius = self.normal_radius or self.max_correspondence_distance
        if planar:
            normals = normals_2d(points, radius, self.normal_neighbours)
            pcd.normals = o3d.utility.Vector3dVector(normals)
        else:
            pcd.estimate_normals(
                o3d.geometry.KDTreeSearchParamHybrid(radius, self.normal_neighbours)
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
            self.criteria,
        )
