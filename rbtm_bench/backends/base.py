"""What a backend is: ``prepare`` once a scan, ``register`` many pairs.

``Backend`` does what every method needs, once: it checks its input, keeps planar data in the
plane, recomputes fitness and RMSE with one evaluator, and refuses to hand out a guess as a
result. A plug-in writes ``build`` and ``align``.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt

from rbtm_bench.backends.neighbours_2d import Sorted2D, sorted_2d
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import is_rigid, to_plane, transform, voxel_downsample
from rbtm_bench.core.types import Array, RegistrationResult, Scan
from rbtm_bench.odometry.judge import compile_kernels, evaluate

MIN_POINTS = 6
"""Fewer points than this cannot hold six degrees of freedom against noise: an error."""
MIN_INLIERS = 3
"""With fewer inliers a plane motion is not determined: never called converged."""

OUT_OF_PLANE = [2, 3, 4]
"""z, rx and ry among x, y, z, rx, ry, rz."""

TargetKey = tuple[tuple[int, bytes | None], ...]
"""The scans that a prepared cloud holds: their numbers, and for merged ones where they lie."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A scan ready to be registered many times; never modified.

    ``points`` (N, 3) m, thinned; ``native`` is whatever the backend built from them. ``key``
    names the scans that it holds, and ``seconds`` is what its preparation took.
    """

    points: Array
    planar: bool
    native: Any
    key: TargetKey = ()
    seconds: float = 0.0

    @cached_property
    def tree(self) -> Any:
        """Nearest-neighbour tree of a cloud's points, for the evaluator."""
        from scipy.spatial import cKDTree

        return cKDTree(self.points)

    @cached_property
    def sorted(self) -> Sorted2D:
        """The same for planar points."""
        return sorted_2d(self.points)


@dataclass(frozen=True, eq=False)
class Alignment:
    """What a library says of one registration; None where it does not say.

    ``information`` is the (6, 6) information of a small motion d = (x, y, z, rx, ry, rz) in m and
    rad of the source in its own frame, T_target_source exp(d), in 1/m^2, 1/rad^2 and between.
    """

    T_target_source: Array
    converged: bool | None = None
    iterations: int | None = None
    information: Array | None = None
    library_fitness: float | None = None
    library_rmse: float | None = None


class Backend(ABC):
    """A registration method. ``max_correspondence_distance`` (m) is also the evaluator's radius;
    ``voxel_size`` (m, 0: off) thins every scan before the method sees it."""

    requires: tuple[str, ...] = ()
    """Names of the Python packages that must be importable."""
    library: str = ""
    """What does the work, with its licence, for the page of backends."""
    converged_means: str = "not said by the library"
    """When ``converged`` is True, in words; False always means fewer than 3 inliers, at least."""
    repeats: str = "same bits"
    """What makes results repeat bit for bit, and the threads it uses, in words."""
    dimensions: tuple[Literal["2d", "3d"], ...] = ("2d", "3d")
    """What the method can register: planar scans ("2d"), clouds in space ("3d")."""
    is_baseline: bool = False
    """True for a method that hands back its guess: the contract does not expect it to be right."""
    uses_guess: bool = True
    """False for a global method, which looks at the whole space of motions whatever the guess."""
    self_tolerance: float = 1e-6
    """How far (m, rad) from no motion a scan registered to itself may end. More than 1e-6 only for
    methods that do not compare points with points, but with cells, bins or averages of them."""
    saved_seconds: float = 0.0
    """What the last answer would have taken, had it not been shared; plug-ins leave it alone."""

    def __init__(
        self,
        max_correspondence_distance: Annotated[float, Gt(0)] = 0.3,
        voxel_size: Annotated[float, Ge(0)] = 0.0,
    ) -> None:
        self.max_correspondence_distance = max_correspondence_distance
        self.voxel_size = voxel_size
        compile_kernels()

    @abstractmethod
    def build(self, points: Array, planar: bool) -> Any:
        """The library's own form of points (N, 3) m: trees, normals, covariances, maps."""

    @abstractmethod
    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        """Align source to target from an initial guess. Must not modify its arguments."""

    def prepare(self, scan: Scan) -> Prepared:
        """Thin and build a scan, once. Raises ``BackendError`` on points that are not finite or
        too few (fewer than 6)."""
        started = time.perf_counter()
        points = np.array(scan.points, dtype=np.float64, order="C")  # the scan's stay as they are
        if points.ndim != 2 or points.shape[1] != 3:
            raise BackendError(f"scan {scan.index}: points {points.shape}: expected (N, 3)")
        if not np.isfinite(points).all():
            raise BackendError(f"scan {scan.index}: some points are not finite")
        thinned = voxel_downsample(points, self.voxel_size)
        return self._prepared(thinned, scan.planar, ((scan.index, None),), started)

    def merge(self, parts: Sequence[tuple[Prepared, Array]]) -> Prepared:
        """One target out of several prepared scans, each with its T_target_part (4, 4)."""
        started = time.perf_counter()
        points = np.concatenate([transform(T, part.points) for part, T in parts])
        thinned = voxel_downsample(points, self.voxel_size)
        key = tuple((number, T.tobytes()) for part, T in parts for number, _ in part.key)
        return self._prepared(thinned, all(part.planar for part, _ in parts), key, started)

    def register(
        self, source: Prepared, target: Prepared, T_target_source: Array
    ) -> RegistrationResult:
        """Register source to target from the initial guess ``T_target_source`` (4, 4).

        ``converged`` is False, whatever the library says, when fewer than 3 source points lie
        within the radius of the target. ``seconds`` is the method's own time.
        Raises ``BackendError`` for a guess that is no rigid motion, or if the library fails.
        """
        guess = np.array(T_target_source, dtype=np.float64)
        if not is_rigid(guess):
            raise BackendError("the initial guess is not a rigid 4x4 motion")
        started = time.perf_counter()
        try:
            alignment = self.align(source, target, guess)
        except BackendError:
            raise
        except Exception as error:
            raise BackendError(f"{type(self).__name__}: {type(error).__name__}: {error}") from error
        seconds = time.perf_counter() - started
        T = np.array(alignment.T_target_source, dtype=np.float64)
        if not is_rigid(T, tolerance=1e-5):
            raise BackendError(f"{type(self).__name__} returned no rigid motion")
        information = alignment.information
        if information is not None:
            information = np.array(information, dtype=np.float64)
            if information.shape != (6, 6):
                raise BackendError(f"information {information.shape}: expected (6, 6)")
        if source.planar and target.planar:
            T = to_plane(T)
            if information is not None:
                information[OUT_OF_PLANE], information[:, OUT_OF_PLANE] = 0.0, 0.0
        # a library's own kind of bool would not be the `False` that checks look for
        converged = None if alignment.converged is None else bool(alignment.converged)
        found = evaluate(source, target, T, self.max_correspondence_distance)
        return RegistrationResult(
            T_target_source=T,
            converged=False if found.inliers < MIN_INLIERS else converged,
            fitness=found.fitness,
            inlier_rmse=found.inlier_rmse,
            inliers=found.inliers,
            iterations=alignment.iterations,
            seconds=seconds,
            information=information,
            library_fitness=alignment.library_fitness,
            library_rmse=alignment.library_rmse,
            localizability=found.localizability,
        )

    def _prepared(self, points: Array, planar: bool, key: TargetKey, started: float) -> Prepared:
        if len(points) < MIN_POINTS:
            raise BackendError(
                f"scan {key[0][0]}: {len(points)} points: expected at least {MIN_POINTS}"
            )
        native = self.build(points, planar)
        return Prepared(points, planar, native, key, time.perf_counter() - started)
