"""The four methods of small_gicp (Koide 2024): ICP, point-to-plane, GICP and voxelised GICP."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt

from rbtm_bench.backends.base import Alignment, Backend, MapLimits, Prepared, RunningMap
from rbtm_bench.backends.planar import lifted
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.geometry import se3, symmetric, to_plane
from rbtm_bench.core.kinds import Distance, VoxelSize
from rbtm_bench.core.types import Array

Positive = Annotated[float, Gt(0)]

TRANSLATION_FIRST = np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])
"""small_gicp's order is rx, ry, rz, x, y, z."""
CYCLE = 100.0
"""Last steps up to this many times the epsilons are those of a cycle."""
CLEAR_CYCLE = 10
"""Scans after which a running map looks for what it may forget, the library's own number."""
PLANAR_ROUND = 8
"""Iterations before a scan of upright walls is put back into the plane."""


@dataclass(frozen=True, eq=False)
class SmallCloud:
    """A scan in the library's own form. ``tree`` finds nearest points; the voxelised method looks
    into voxels of ``cell_size`` m instead. ``layers`` is how often the cloud holds each point."""

    cloud: Any
    tree: Any | None
    layers: int
    cell_size: float | None = None

    @cached_property
    def voxels(self) -> Any | None:
        """The Gaussian voxels of the scan, made when it is first a target by itself."""
        if self.cell_size is None:
            return None
        import small_gicp

        voxels = small_gicp.GaussianVoxelMap(self.cell_size)
        voxels.insert(self.cloud, se3(np.full(3, 0.5 * self.cell_size), np.eye(3)))
        return voxels


@dataclass(frozen=True, eq=False)
class SmallVoxels:
    """Nothing but the Gaussian voxels of many scans."""

    voxels: Any


class GaussianMap(RunningMap):
    """small_gicp's ``GaussianVoxelMap``: voxels of ``cell_size`` m that none of the last
    ``horizon`` scans met are forgotten every ``CLEAR_CYCLE`` scans, however far they are. Its
    points are the means of the voxels."""

    def __init__(self, cell_size: float, horizon: int) -> None:
        import small_gicp

        self._voxels = small_gicp.GaussianVoxelMap(cell_size)
        self._voxels.set_lru(horizon=horizon, clear_cycle=CLEAR_CYCLE)
        self._half, self._planar = 0.5 * cell_size, True

    def insert(self, scan: Prepared, T_map_scan: Array) -> None:
        T = T_map_scan.copy()
        T[:3, 3] += self._half  # as `align` has it
        self._voxels.insert(scan.native.cloud, T)
        self._planar = self._planar and scan.planar

    def target(self) -> Prepared:
        points = self._voxels.voxel_points()[:, :3] - self._half
        if self._planar:  # one of the two layers
            points = points[points[:, 2] > 0.0] * [1.0, 1.0, 0.0]
        return Prepared(np.ascontiguousarray(points), self._planar, SmallVoxels(self._voxels))


class SmallGICP(Backend):
    """``small_gicp.align`` (MIT licence), Levenberg-Marquardt, on one thread, so repeatable.

    ``method``: ICP (Besl and McKay 1992), PLANE_ICP (Chen and Medioni 1992), GICP (Segal, Haehnel
    and Thrun 2009), or VGICP (Koide et al. 2021), which compares a point with the voxel around it:
    the mean of its points and of their covariances. Voxels are ``cell_size`` m wide (None: the
    correspondence distance), one of them centred on the sensor, since a floor right on the border
    of voxels is torn in two. Normals and covariances come from the ``neighbours`` nearest points.
    ``max_correspondence_distance`` holds to points, for VGICP to the voxels' means. It stops after
    ``max_iterations``, or at a step below ``rotation_epsilon`` (rad) and ``translation_epsilon``
    (m); the library's own defaults are 0.1 deg and 1 mm, at which ICP is still on its way.

    ``converged``: True if the last step was that small, or if none lowers the error and the
    undamped one would be that small (the library calls a scan registered to itself failed). None
    if it gave up before, or ended among steps less than 100 times as large: on sparse scans it
    often goes round between two sets of correspondences, millimetres apart, without end. False if
    it was still on its way, or with nothing within the distance (the library calls that a success).

    PLANE_ICP is not quite point-to-plane in this library: it weighs the x, y and z of a difference
    by those of the normal, each by itself, instead of taking the distance along the normal. On
    walls oblique to the target's axes it is partly point-to-point, and sees along a corridor.

    The information is the library's Hessian: per m^2 for ICP and PLANE_ICP. For GICP and VGICP the
    covariances are relative (1 along a surface, 0.001 across), so only its shape means something.
    Planar scans are registered in two layers (see ``lifted``), except by ICP: half of the
    neighbours come from either, and the information is halved.
    """

    requires = ("small_gicp",)
    library = "small_gicp (MIT), the extra `small-gicp`"
    converged_means = "last step below the epsilons, or none lowers the error; None in a cycle"
    repeats = "same bits; one thread"

    def __init__(
        self,
        method: Literal["ICP", "PLANE_ICP", "GICP", "VGICP"] = "GICP",
        max_correspondence_distance: Distance = 0.3,
        voxel_size: VoxelSize = 0.0,
        neighbours: Annotated[int, Ge(6)] = 10,
        cell_size: Distance | None = None,
        max_iterations: Annotated[int, Ge(1)] = 50,
        rotation_epsilon: Positive = 1e-4,
        translation_epsilon: Positive = 1e-4,
    ) -> None:
        if cell_size is not None and method != "VGICP":
            raise ConfigError(f"backend.cell_size={cell_size:g}: {method} has no cells")
        super().__init__(max_correspondence_distance, voxel_size)
        self.method = method
        self.neighbours = neighbours
        self.rotation_epsilon = rotation_epsilon
        self.translation_epsilon = translation_epsilon
        self.max_iterations = max_iterations
        self.cell_size = (cell_size or max_correspondence_distance) if method == "VGICP" else None
        self.half_cell = 0.0
        if self.cell_size is not None:
            self.half_cell = 0.5 * self.cell_size  # the library's voxels begin at the origin
            self.self_tolerance = 0.01  # points are compared with the means of voxels

    def build(self, points: Array, planar: bool) -> SmallCloud:
        import small_gicp

        if self.method == "ICP":  # nothing else, so z = 0 is no trouble
            cloud = small_gicp.PointCloud(points)
            return SmallCloud(cloud, small_gicp.KdTree(cloud), 1)
        layers = 2 if planar else 1
        raised = lifted(points, self.cell_size) if planar else points
        cloud = small_gicp.PointCloud(raised)
        tree = small_gicp.KdTree(cloud)
        # sought among points without height, neighbours come in pairs, one from either layer
        near = small_gicp.KdTree(np.tile(points, (2, 1))) if planar else tree
        estimate = (
            small_gicp.estimate_normals
            if self.method == "PLANE_ICP"
            else small_gicp.estimate_covariances
        )
        estimate(cloud, near, self.neighbours // layers * layers, 1)
        return SmallCloud(cloud, None if self.cell_size else tree, layers, self.cell_size)

    def running_map(self, limits: MapLimits) -> RunningMap | None:
        """Gaussian voxels, for VGICP; the other methods compare points."""
        if self.cell_size is None:
            return None
        return GaussianMap(self.cell_size, limits.horizon)

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        cloud, model = source.native, target.native
        # nothing holds upright walls in z, where ever less damping lets rounding errors grow
        leaves_plane = self.method == "PLANE_ICP" and source.planar
        most = PLANAR_ROUND if leaves_plane else self.max_iterations
        T, iterations = T_target_source.copy(), 0
        T[:3, 3] += self.half_cell
        while True:
            limit = min(most, self.max_iterations - iterations)
            result = self._call(cloud, model, T, limit)
            T = np.array(result.T_target_source)
            if leaves_plane:
                T = to_plane(T)
            steps = int(result.iterations) + 1  # the library's count starts at 0
            iterations += steps
            if result.converged or steps < limit or iterations >= self.max_iterations:
                break
        T[:3, 3] -= self.half_cell
        information = symmetric(result.H[TRANSLATION_FIRST])
        return Alignment(
            T,
            converged=self._converged(result, steps == limit),
            iterations=iterations,
            information=information / cloud.layers,
            library_fitness=result.num_inliers / cloud.cloud.size(),
        )

    def _call(
        self, source: SmallCloud, target: SmallCloud | SmallVoxels, T: Array, iterations: int
    ) -> Any:
        import small_gicp

        limits = {
            "max_correspondence_distance": self.max_correspondence_distance,
            "num_threads": 1,
            "max_iterations": iterations,
            "rotation_epsilon": self.rotation_epsilon,
            "translation_epsilon": self.translation_epsilon,
        }
        if isinstance(target, SmallVoxels) or target.voxels is not None:
            return small_gicp.align(target.voxels, source.cloud, T, **limits)
        return small_gicp.align(
            target.cloud, source.cloud, target.tree, T, registration_type=self.method, **limits
        )

    def _converged(self, result: Any, is_out_of_iterations: bool) -> bool | None:
        """What the class says."""
        if result.num_inliers == 0:
            return False
        if result.converged:
            return True
        damping = 1e-9 * np.trace(result.H) * np.eye(6)  # along what the points cannot see
        step = np.linalg.solve(result.H + damping, -result.b)
        turn = float(np.linalg.norm(step[:3])) / self.rotation_epsilon
        shift = float(np.linalg.norm(step[3:])) / self.translation_epsilon
        if is_out_of_iterations:
            return None if max(turn, shift) < CYCLE else False
        return True if max(turn, shift) < 1.0 else None
