"""What Open3D's ICP methods share: clouds, robust kernels, shrinking distances, information."""

# No postponed annotations in this class and its subclasses: settings are checked against the types
# of these fields, which a subclass in another module inherits.
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt

from rbtm_bench.backends.base import Alignment, Backend, Prepared
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.geometry import information_in_source_frame
from rbtm_bench.core.kinds import Distance, VoxelSize
from rbtm_bench.core.open3d_library import open3d
from rbtm_bench.core.types import Array

Kernel = Literal["none", "huber", "cauchy", "geman_mcclure", "tukey"]
Positive = Annotated[float, Gt(0)]


@dataclass(eq=False)
class Open3DICP(Backend):
    """``open3d.pipelines.registration`` (MIT licence), iterated over shrinking distances.

    Parameters: ``max_iterations`` per distance; ``relative_fitness`` and ``relative_rmse``, the
    changes below which Open3D stops; ``kernel`` and ``kernel_scale`` (m), a robust weight on
    residuals; ``coarse_to_fine``, factors of ``max_correspondence_distance`` gone through in
    order, e.g. [4, 2, 1]. Open3D says neither whether it converged nor how many iterations it
    took: both are None. Repeatable on one core only: Open3D adds in the order of its threads.

    The information is Open3D's own (``get_information_matrix_from_point_clouds``, Choi, Zhou and
    Koltun 2015) whatever the method and its kernel: every pair within the distance counts 1/m^2 in
    all directions. So it grows with the overlap, but a bare corridor looks well held.
    """

    requires = ("open3d",)
    library = "Open3D (MIT)"
    repeats = "same bits on one core only (`pin=true`)"

    max_correspondence_distance: Distance = 0.3
    voxel_size: VoxelSize = 0.0
    max_iterations: Annotated[int, Ge(1)] = 50
    relative_fitness: Positive = 1e-6
    relative_rmse: Positive = 1e-6
    kernel: Kernel = "none"
    kernel_scale: Positive = 0.1
    coarse_to_fine: Sequence[Positive] = (1.0,)

    def __post_init__(self) -> None:
        if len(self.coarse_to_fine) == 0:
            raise ConfigError("backend.coarse_to_fine=[]: expected at least one factor")
        super().__init__(self.max_correspondence_distance, self.voxel_size)
        self.distances = [f * self.max_correspondence_distance for f in self.coarse_to_fine]
        self.criteria = _registration().ICPConvergenceCriteria(
            self.relative_fitness, self.relative_rmse, self.max_iterations
        )

    @abstractmethod
    def icp(self, source: Any, target: Any, distance: float, guess: Array) -> Any:
        """One call of the library: source and target clouds -> its RegistrationResult."""

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        T = T_target_source
        for distance in self.distances:
            result = self.icp(source.native, target.native, distance, T)
            T = np.asarray(result.transformation)
        matched = target.points.take(np.asarray(result.correspondence_set)[:, 1], axis=0)
        return Alignment(
            T,
            information=information_in_source_frame(point_information(matched), T),
            library_fitness=result.fitness,
            library_rmse=result.inlier_rmse,
        )

    def robust_kernel(self) -> Any:
        """The library's kernel object; the scale is in m."""
        registration, scale = _registration(), self.kernel_scale
        return {
            "none": lambda: registration.L2Loss(),
            "huber": lambda: registration.HuberLoss(scale),
            "cauchy": lambda: registration.CauchyLoss(scale),
            "geman_mcclure": lambda: registration.GMLoss(scale**2),
            "tukey": lambda: registration.TukeyLoss(scale),
        }[self.kernel]()


def point_information(points: Array) -> Array:
    """The (6, 6) information of a small motion d = (x, y, z, rx, ry, rz) of matched points (N, 3)
    m about their origin: the sum of J^T J with J = [I, -skew(p)], the motion of a point.

    Open3D's definition, from correspondences already known, translation first.
    """
    n = float(len(points))
    x, y, z = (points.T @ np.ones(len(points))).tolist()
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = (points.T @ points).tolist()
    return np.array(
        [
            [n, 0.0, 0.0, 0.0, z, -y],
            [0.0, n, 0.0, -z, 0.0, x],
            [0.0, 0.0, n, y, -x, 0.0],
            [0.0, -z, y, yy + zz, -xy, -xz],
            [z, 0.0, -x, -xy, xx + zz, -yz],
            [-y, x, 0.0, -xz, -yz, xx + yy],
        ]
    )


def cloud(points: Array) -> Any:
    """An Open3D point cloud of points (N, 3)."""
    o3d = open3d()

    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))


def _registration() -> Any:
    o3d = open3d()

    return o3d.pipelines.registration
