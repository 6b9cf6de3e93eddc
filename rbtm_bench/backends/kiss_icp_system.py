"""KISS-ICP's whole odometry (Vizzo et al. 2023), a system: it needs no selector and no guess."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt

from rbtm_bench.backends.base import MIN_POINTS
from rbtm_bench.backends.system import System, Tracker
from rbtm_bench.core.errors import BackendError, ConfigError
from rbtm_bench.core.geometry import inverse, to_plane, transform
from rbtm_bench.core.kinds import Distance
from rbtm_bench.core.types import Array

Positive = Annotated[float, Gt(0)]

RANGE = 100.0
"""m, KISS-ICP's own default."""
VOXEL, THRESHOLD, MOTION = 0.01, 0.02, 0.001
"""KISS-ICP's own defaults of 1, 2 and 0.1 m as shares of that range."""

SAME = 1e-12
"""m, rad: a pose this close to the prediction may be nothing but the prediction."""


class KissICPSystem(System):
    """``kiss_icp.kiss_icp.KissICP.register_frame`` (MIT licence): scans registered to a local map
    from a constant-velocity guess, with a correspondence threshold that adapts to how far the guess
    was off.

    ``max_range`` (m, null: 100) and ``min_range`` (m) bound the points that are used, and the first
    also the local map. Unless set, what KISS-ICP has for cars and 100 m is scaled with the range:
    ``voxel_size`` of the map (m, null: range / 100), ``initial_threshold`` (m, null: range / 50;
    three times it is the first correspondence distance) and ``min_motion_th`` (m, null: range /
    1000; smaller corrections do not adapt the threshold). ``max_points_per_voxel`` is the map's;
    ``max_iterations`` and ``convergence_criterion`` (norm of the last update, m and rad) are those
    of a registration. All defaults together are KISS-ICP's own.

    Deskewing is done before (``deskew=true``), there is one thread, and no chance in it. Planar
    scans stay in the plane. The library says nothing of success: ``converged`` is False where the
    pose is the prediction because no point lay near the map, else None.
    """

    requires = ("kiss_icp",)
    library = "KISS-ICP (MIT)"
    converged_means = "not reported; False where nothing of the scan meets the map"
    repeats = "same bits; one thread, the library's limit"

    def __init__(
        self,
        max_range: Positive | None = None,
        min_range: Annotated[float, Ge(0)] = 0.0,
        voxel_size: Distance | None = None,
        max_points_per_voxel: Annotated[int, Ge(1)] = 20,
        initial_threshold: Positive | None = None,
        min_motion_th: Positive | None = None,
        max_iterations: Annotated[int, Ge(1)] = 500,
        convergence_criterion: Positive = 1e-4,
    ) -> None:
        reach = max_range or RANGE
        if reach <= min_range:
            raise ConfigError(
                f"backend.min_range={min_range:g}: expected less than max_range={reach:g}"
            )
        self.max_range, self.min_range = reach, min_range
        self.voxel_size = voxel_size or VOXEL * reach
        self.max_points_per_voxel = max_points_per_voxel
        self.initial_threshold = initial_threshold or THRESHOLD * reach
        self.min_motion_th = min_motion_th or MOTION * reach
        self.max_iterations, self.convergence_criterion = max_iterations, convergence_criterion

    def start(self) -> Tracker:
        return _Pipeline(self.library_config())

    def library_config(self) -> Any:
        """KISS-ICP's own configuration, every field given: it would read environment variables."""
        from kiss_icp.config.config import (
            AdaptiveThresholdConfig,
            DataConfig,
            MappingConfig,
            RegistrationConfig,
        )
        from kiss_icp.config.parser import KISSConfig

        return KISSConfig(
            out_dir="",
            data=DataConfig(max_range=self.max_range, min_range=self.min_range, deskew=False),
            mapping=MappingConfig(
                voxel_size=self.voxel_size, max_points_per_voxel=self.max_points_per_voxel
            ),
            registration=RegistrationConfig(
                max_num_iterations=self.max_iterations,
                convergence_criterion=self.convergence_criterion,
                # the thread limit is global to the process and the first value wins: always one
                max_num_threads=1,
            ),
            adaptive_threshold=AdaptiveThresholdConfig(
                fixed_threshold=None,
                initial_threshold=self.initial_threshold,
                min_motion_th=self.min_motion_th,
            ),
        )


class _Pipeline(Tracker):
    """One ``KissICP``."""

    def __init__(self, config: Any) -> None:
        from kiss_icp.kiss_icp import KissICP

        self._kiss = KissICP(config)
        self._kiss.registration = _Watched(self._kiss.registration)

    def place(self, points: Array, planar: bool) -> tuple[Array, bool | None]:
        kiss, reach = self._kiss, self._kiss.config.data
        distance = np.linalg.norm(points, axis=1)
        near = int(((distance > reach.min_range) & (distance < reach.max_range)).sum())
        if near < MIN_POINTS:
            raise BackendError(
                f"{near} points within {reach.min_range:g} to {reach.max_range:g} m: "
                f"expected at least {MIN_POINTS}"
            )
        before = kiss.last_pose
        kiss.register_frame(points, np.empty(0))
        if planar:
            kiss.last_pose = to_plane(kiss.last_pose)
            kiss.last_delta = inverse(before) @ kiss.last_pose
        return kiss.last_pose, kiss.registration.converged


class _Watched:
    """KISS-ICP's registration, which hands back its guess where nothing corresponds. Watched,
    because only its call has the guess and the map as it was."""

    def __init__(self, registration: Any) -> None:
        self._registration = registration
        self.converged: bool | None = None

    def align_points_to_map(
        self,
        points: Array,
        voxel_map: Any,
        initial_guess: Array,
        max_correspondance_distance: float,  # the library's spelling
        kernel: float,
    ) -> Any:
        T = self._registration.align_points_to_map(
            points=points,
            voxel_map=voxel_map,
            initial_guess=initial_guess,
            max_correspondance_distance=max_correspondance_distance,
            kernel=kernel,
        )
        is_guess = np.abs(T - initial_guess).max() <= SAME
        lost = (
            is_guess
            and not voxel_map.empty()
            and not _meets(points, voxel_map, T, max_correspondance_distance)
        )
        self.converged = False if lost else None
        return T


def _meets(points: Array, voxel_map: Any, T: Array, distance: float) -> bool:
    """Whether any point (N, 3), moved by T, has a point of the map within ``distance`` (m)."""
    from scipy.spatial import cKDTree

    nearest, _ = cKDTree(voxel_map.point_cloud()).query(
        transform(T, points), distance_upper_bound=distance
    )
    return bool(np.isfinite(nearest).any())
