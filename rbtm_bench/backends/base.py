"""What a backend is: ``prepare`` once a scan, ``register`` many pairs.

``Backend`` does what every method needs, once: it checks its input, keeps planar data in the
plane, and lets through nothing that is no motion. What comes out is a pose and what the library
says of it; judging it is the business of whoever registers a pair (``odometry.judge``). A plug-in
writes ``build`` and ``align``.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from rbtm_bench.backends.neighbours_2d import Sorted2D, sorted_2d
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import is_rigid, symmetric, to_plane, transform, voxel_downsample
from rbtm_bench.core.kinds import Distance, VoxelSize
from rbtm_bench.core.types import Array, Scan

MIN_POINTS = 6
"""Fewer points than this cannot hold six degrees of freedom against noise: an error."""
OUT_OF_PLANE = [2, 3, 4]
"""z, rx and ry among x, y, z, rx, ry, rz."""

PROGRAMMING_ERRORS = (
    AttributeError,
    AssertionError,
    ImportError,
    KeyError,
    NameError,
    NotImplementedError,
    TypeError,
)
"""What a plug-in raises because it is wrong, not because two scans do not match: the run fails,
and does not go on as if every registration had been refused."""

TargetKey = tuple[tuple[int, bytes | None], ...]
"""The scans that a prepared cloud holds: their numbers, and for merged ones where they lie."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A scan ready to be registered many times; never modified.

    ``points`` (N, 3) m, thinned; ``native`` is whatever the backend built from them. ``key``
    names the scans that it holds.
    """

    points: Array
    planar: bool
    native: Any
    key: TargetKey = ()

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
    ``seconds`` is the method's own time, measured around ``align``.
    """

    T_target_source: Array
    converged: bool | None = None
    iterations: int | None = None
    information: Array | None = None
    library_fitness: float | None = None
    library_rmse: float | None = None
    seconds: float = 0.0


class Backend(ABC):
    """A registration method. ``max_correspondence_distance`` (m) is also the judge's radius;
    ``voxel_size`` (m, 0: off) thins every scan before the method sees it."""

    requires: tuple[str, ...] = ()
    """Names of the Python packages that must be importable."""
    library: str = ""
    """What does the work, with its licence, for the page of backends."""
    converged_means: str = "not reported by the library"
    """When ``converged`` is True, in words; never so, for the judge, with fewer than 3 inliers."""
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

    def __init__(
        self,
        max_correspondence_distance: Distance = 0.3,
        voxel_size: VoxelSize = 0.0,
    ) -> None:
        self.max_correspondence_distance = max_correspondence_distance
        self.voxel_size = voxel_size

    @abstractmethod
    def build(self, points: Array, planar: bool) -> Any:
        """The library's own form of points (N, 3) m: trees, normals, covariances, maps."""

    @abstractmethod
    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        """Align source to target from an initial guess. Must not modify its arguments."""

    def prepare(self, scan: Scan) -> Prepared:
        """Thin and build a scan, once. Raises ``BackendError`` on points that are not finite or
        too few (fewer than 6)."""
        points = np.array(scan.points, dtype=np.float64, order="C")  # the scan's stay as they are
        if points.ndim != 2 or points.shape[1] != 3:
            raise BackendError(f"scan {scan.index}: points {points.shape}: expected (N, 3)")
        if not np.isfinite(points).all():
            raise BackendError(f"scan {scan.index}: some points are not finite")
        thinned = voxel_downsample(points, self.voxel_size)
        return self._prepared(thinned, scan.planar, ((scan.index, None),))

    def merge(self, parts: Sequence[tuple[Prepared, Array]]) -> Prepared:
        """One target out of several prepared scans, each with its T_target_part (4, 4)."""
        points = np.concatenate([transform(T, part.points) for part, T in parts])
        thinned = voxel_downsample(points, self.voxel_size)
        key = tuple((number, T.tobytes()) for part, T in parts for number, _ in part.key)
        return self._prepared(thinned, all(part.planar for part, _ in parts), key)

    def register(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        """Register source to target from the initial guess ``T_target_source`` (4, 4).

        Returns what ``align`` says, its motion float64 and, between planar scans, in the plane,
        its information symmetric. Raises ``TypeError`` or ``ValueError`` for a caller's mistake,
        ``BackendError`` if the library fails, and what a wrong plug-in raises as it is.
        """
        guess = _checked_guess(source, target, T_target_source)
        name = type(self).__name__
        started = time.perf_counter()
        try:
            alignment: Any = self.align(source, target, guess)  # a plug-in may return anything
        except (BackendError, *PROGRAMMING_ERRORS):
            raise
        except Exception as error:
            raise BackendError(f"{name}: {type(error).__name__}: {error}") from error
        seconds = time.perf_counter() - started
        if not isinstance(alignment, Alignment):
            kind = type(alignment).__name__
            raise TypeError(f"{name}.align returned {kind}: expected an Alignment")
        T = np.array(alignment.T_target_source, dtype=np.float64)
        if not is_rigid(T, tolerance=1e-5):
            raise BackendError(f"{name} returned no rigid motion")
        planar = source.planar and target.planar
        return replace(
            alignment,
            T_target_source=to_plane(T) if planar else T,
            # a library's own kind of bool would not be the `False` that checks look for
            converged=None if alignment.converged is None else bool(alignment.converged),
            information=_checked_information(alignment.information, planar),
            seconds=seconds,
        )

    def _prepared(self, points: Array, planar: bool, key: TargetKey) -> Prepared:
        if len(points) < MIN_POINTS:
            raise BackendError(
                f"scan {key[0][0]}: {len(points)} points: expected at least {MIN_POINTS}"
            )
        return Prepared(points, planar, self.build(points, planar), key)


def _checked_guess(source: Any, target: Any, T_target_source: Any) -> Array:
    """The guess as float64. Raises ``TypeError`` or ``ValueError`` for what is none."""
    for name, cloud in (("source", source), ("target", target)):
        if not isinstance(cloud, Prepared):
            kind = type(cloud).__name__
            raise TypeError(f"{name} is {kind}: expected what prepare() returns, a Prepared")
    try:
        guess = np.array(T_target_source, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise TypeError(f"T_target_source is no array of numbers: {error}") from error
    if not is_rigid(guess):
        raise ValueError("the initial guess is not a rigid 4x4 motion")
    return guess


def _checked_information(given: Array | None, planar: bool) -> Array | None:
    """The information (6, 6), symmetric to the last bit, which a product of matrices is not on
    every processor; in the plane without what leaves it. Raises ``BackendError`` for other shapes.
    """
    if given is None:
        return None
    information = np.array(given, dtype=np.float64)
    if information.shape != (6, 6):
        raise BackendError(f"information {information.shape}: expected (6, 6)")
    information = symmetric(information)
    if planar:
        information[OUT_OF_PLANE], information[:, OUT_OF_PLANE] = 0.0, 0.0
    return information
