"""KISS-ICP's registration (Vizzo et al. 2023) of a scan to a voxel map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt

from rbtm_bench.backends.base import Alignment, Backend, MapLimits, Prepared, RunningMap
from rbtm_bench.backends.kiss_icp_system import RANGE, KissICPSystem
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.kinds import Distance, VoxelSize
from rbtm_bench.core.types import Array

Positive = Annotated[float, Gt(0)]

DISTANCE, INITIAL, MOTION = 3.0, 2.0, 0.1
"""KISS-ICP's own ratios: the correspondence distance over the threshold; the first threshold, and
the least correction that it adapts to, over the map's voxel."""


@dataclass(frozen=True, eq=False)
class KissScan:
    """A scan alone: its hash ``map``, and the points that it kept, which are the source's points
    as well, so that a scan meets itself exactly. Beside a running map it is thinned as KISS-ICP
    does: ``thinned`` goes into the map, ``source`` is registered."""

    map: Any
    kept: Array
    thinned: Array
    source: Array


class KissMap(RunningMap):
    """KISS-ICP's hash map of many scans, and its threshold, which adapts to how far registrations
    ended from their guesses: the last one before a scan is added to the map counts."""

    def __init__(self, voxels: Any, threshold: Any) -> None:
        self.map, self.threshold = voxels, threshold
        self.deviation: Array | None = None
        self._planar = True

    def insert(self, scan: Prepared, T_map_scan: Array) -> None:
        if self.deviation is not None:
            self.threshold.update_model_deviation(self.deviation)
            self.deviation = None
        self.map.update(scan.native.thinned, T_map_scan)
        self._planar = self._planar and scan.planar

    def target(self) -> Prepared:
        return Prepared(np.array(self.map.point_cloud()), self._planar, self)


class KissICP(Backend):
    """``kiss_icp.registration.Registration.align_points_to_map`` (MIT licence).

    Point-to-point with a Geman-McClure-like kernel of ``kernel`` m (null: a third of the
    correspondence distance, KISS-ICP's own ratio), to a map that is searched one voxel of
    ``map_voxel_size`` m around a point (null: the correspondence distance).

    With ``target=map`` it is KISS-ICP's whole odometry but for its guess and its model scan
    (``guess=constant_velocity``, ``selector=previous``): a running map with up to
    ``map_points_per_voxel``, a scan thinned to a point in ``map_thinning`` voxels for the map and,
    of these, in ``source_thinning`` voxels for the source, and an adaptive threshold that starts at
    ``initial_threshold`` m (null: 2 voxels) and is the kernel; thrice that is the correspondence
    distance. Corrections below ``min_motion_th`` m (null: a tenth of a voxel) do not adapt it; a
    turn counts by what it moves at ``max_range`` m (null: 100).

    To a target of scans, which remembers nothing, all points are registered, with distance and
    kernel as they are set, and ``max_points_per_voxel`` are kept: thinned like a map, two planar
    scans would have too few points for millimetres.

    The library gives only a pose (its guess, where nothing corresponds): ``converged`` is False
    without inliers, else None.
    """

    requires = ("kiss_icp",)
    library = "KISS-ICP (MIT)"
    repeats = "same bits; one thread, the library's limit"

    def __init__(
        self,
        max_correspondence_distance: Distance = 0.3,
        voxel_size: VoxelSize = 0.0,
        kernel: Positive | None = None,
        map_voxel_size: Distance | None = None,
        max_points_per_voxel: Annotated[int, Ge(1)] = 100,
        map_points_per_voxel: Annotated[int, Ge(1)] = 20,
        map_thinning: Positive = 0.5,
        source_thinning: Positive = 1.5,
        initial_threshold: Positive | None = None,
        min_motion_th: Positive | None = None,
        max_iterations: Annotated[int, Ge(1)] = 500,
        convergence_criterion: Positive = 1e-4,
        max_range: Positive | None = None,
    ) -> None:
        super().__init__(max_correspondence_distance, voxel_size)
        from kiss_icp.registration import Registration

        self.kernel = kernel or max_correspondence_distance / DISTANCE
        self.map_voxel_size = voxel = map_voxel_size or max_correspondence_distance
        self.max_points_per_voxel = max_points_per_voxel
        self.map_points_per_voxel = map_points_per_voxel
        self.thinning = map_thinning * voxel, source_thinning * voxel
        self.initial_threshold = initial_threshold or INITIAL * voxel
        self.min_motion_th = min_motion_th or MOTION * voxel
        self.max_range = max_range or RANGE
        # the thread limit is global to the process and the first value wins: always one
        self._registration = Registration(
            max_num_iterations=max_iterations,
            convergence_criterion=convergence_criterion,
            max_num_threads=1,
        )

    def build(self, points: Array, planar: bool) -> KissScan:
        from kiss_icp.voxelization import voxel_down_sample

        thinned = voxel_down_sample(points, self.thinning[0])
        source = voxel_down_sample(thinned, self.thinning[1])
        voxels = self._voxels(self.max_range, self.max_points_per_voxel)
        voxels.add_points(points)
        kept = np.array(voxels.point_cloud())
        return KissScan(voxels, kept, np.array(thinned), np.array(source))

    def running_map(self, limits: MapLimits) -> RunningMap | None:
        from kiss_icp.threshold import AdaptiveThreshold

        config = KissICPSystem(
            max_range=self.max_range,
            initial_threshold=self.initial_threshold,
            min_motion_th=self.min_motion_th,
        ).library_config()
        voxels = self._voxels(limits.max_range, self.map_points_per_voxel)
        return KissMap(voxels, AdaptiveThreshold(config))

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        model, scan = target.native, source.native
        if isinstance(model, KissMap):
            kernel = model.threshold.get_threshold()
            T = self._call(scan.source, model.map, T_target_source, DISTANCE * kernel, kernel)
            model.deviation = inverse(T_target_source) @ T
        else:
            distance = self.max_correspondence_distance
            T = self._call(scan.kept, model.map, T_target_source, distance, self.kernel)
        return Alignment(T)

    def _call(self, points: Array, voxels: Any, T: Array, distance: float, kernel: float) -> Array:
        return np.asarray(
            self._registration.align_points_to_map(
                points=points,
                voxel_map=voxels,
                initial_guess=T,
                max_correspondance_distance=distance,
                kernel=kernel,
            )
        )

    def _voxels(self, max_range: float, most: int) -> Any:
        from kiss_icp.mapping import VoxelHashMap

        return VoxelHashMap(self.map_voxel_size, max_range, most)
