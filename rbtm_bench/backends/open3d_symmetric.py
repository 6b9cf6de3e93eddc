"""Symmetric ICP (after Rusinkiewicz 2019) by Open3D; symmetric point-to-line on planar scans."""

from dataclasses import dataclass
from typing import Any

from rbtm_bench.backends.open3d_icp import _registration
from rbtm_bench.backends.open3d_p2plane import Open3DPointToPlane
from rbtm_bench.core.types import Array


@dataclass(eq=False)
class Open3DSymmetric(Open3DPointToPlane):
    """``registration_symmetric_icp`` (Open3D 0.20 or later).

    A pair of points counts twice: by its distance along the target's normal, as in
    ``Open3DPointToPlane``, whose parameters it takes, and along the source's normal, which turns
    with the source. Rusinkiewicz takes the distance along the sum of both normals instead, and
    splits the rotation between the scans. With a kernel each of the two distances has its own
    weight.
    """

    def icp(self, source: Any, target: Any, distance: float, guess: Array) -> Any:
        registration = _registration()
        return registration.registration_symmetric_icp(
            source,
            target,
            distance,
            guess,
            registration.TransformationEstimationSymmetric(self.robust_kernel()),
            self.criteria,
        )
