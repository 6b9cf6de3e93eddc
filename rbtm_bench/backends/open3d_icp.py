"""What Open3D's ICP methods share: clouds, robust kernels, shrinking distances, information."""

# No postponed annotations in this class and its subclasses: settings are checked against the types
# of these fields, which a subclass in another module inherits.
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt
from numpy.typing import NDArray

from rbtm_bench.backends.base import Alignment, Backend, Prepared
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.kernels import kernel
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
        point_information(np.eye(3), np.zeros((1, 2), np.int32), np.eye(4))  # compiled beforehand

    @abstractmethod
    def icp(self, source: Any, target: Any, distance: float, guess: Array) -> Any:
        """One call of the library: source and target clouds -> its RegistrationResult."""

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        T = T_target_source
        for distance in self.distances:
            result = self.icp(source.native, target.native, distance, T)
            T = np.ascontiguousarray(result.transformation)
        matches = np.asarray(result.correspondence_set)
        return Alignment(
            T,
            information=point_information(target.points, matches, T),
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


@kernel
def point_information(target: Array, matches: NDArray[np.int32], T_target_source: Array) -> Array:
    """The (6, 6) information of a small motion d = (x, y, z, rx, ry, rz) of the source in its own
    frame, of ``matches`` (K, 2) with target points (N, 3) m in their second column: the sum of
    J^T J with J = [I, -skew(p)], the motion of a point p.

    Open3D's definition, from correspondences already known, translation first.
    """
    n = float(len(matches))
    x = y = z = xx = xy = xz = yy = yz = zz = 0.0
    T = T_target_source
    for i in range(len(matches)):
        p = target[matches[i, 1]]
        a, b, c = p[0] - T[0, 3], p[1] - T[1, 3], p[2] - T[2, 3]
        u = T[0, 0] * a + T[1, 0] * b + T[2, 0] * c
        v = T[0, 1] * a + T[1, 1] * b + T[2, 1] * c
        w = T[0, 2] * a + T[1, 2] * b + T[2, 2] * c
        x, y, z = x + u, y + v, z + w
        xx, xy, xz = xx + u * u, xy + u * v, xz + u * w
        yy, yz, zz = yy + v * v, yz + v * w, zz + w * w
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
