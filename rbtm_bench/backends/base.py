"""What a backend is: ``prepare`` once a scan, ``register`` many pairs.

``Backend`` does what every method needs, once: it checks its input, keeps planar data in the
plane, and lets through nothing that is no motion. What comes out is a pose and what the library
says of it; judging it is the business of whoever registers a pair (``odometry.judge``). A plug-in
writes ``build`` and ``align``.
"""

from __future__ import annotations

import hashlib
import math
import operator
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from rbtm_bench.backends.plane_index import PlaneIndex, plane_index
from rbtm_bench.backends.space_index import SpaceIndex, space_index
from rbtm_bench.core.errors import BackendError, one_line
from rbtm_bench.core.geometry import inverse, to_plane, transform, voxel_downsample
from rbtm_bench.core.kinds import Distance, VoxelSize
from rbtm_bench.core.rigid import all_finite, rigidity, symmetric_information
from rbtm_bench.core.types import Array, Scan

MIN_POINTS = 6
"""Fewer points than this cannot hold six degrees of freedom against noise: an error."""
GUESS_TOLERANCE, ANSWER_TOLERANCE = 1e-6, 1e-5
"""How far from rigid (``geometry.rigidity_error``) a guess and a library's answer may be."""

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

MAX_MOTION = 1e4
"""m between two scans. No scan of any sensor reaches as far; what a library returns when its sums
overflow does."""

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
    def index(self) -> PlaneIndex:
        """Where the judge finds the nearest of planar points."""
        return plane_index(self.points)

    @property
    def size(self) -> int:
        """How many points it has."""
        return len(self.points)

    def as_built(self, T_target_source: Array) -> tuple[Prepared, Array]:
        """The cloud in the frame that it was built in, and a motion (4, 4) into its own frame as
        one into that."""
        return self, T_target_source

    @cached_property
    def digest(self) -> bytes:
        """16 bytes that tell its points from others."""
        return hashlib.blake2b(self.points.tobytes(), digest_size=16).digest()

    def cells(self, radius: float) -> SpaceIndex:
        """Where it finds the nearest in space, within ``radius`` m; the last one made is kept."""
        kept: SpaceIndex | None = self.__dict__.get("_cells")
        if kept is None or self.__dict__["_radius"] != radius:
            kept = space_index(self.points, radius)
            self.__dict__.update(_cells=kept, _radius=radius)
        return kept


def joined_key(parts: Sequence[tuple[Prepared, Array]]) -> TargetKey:
    """The key of a cloud made of prepared scans, each with its T_target_part (4, 4)."""
    return tuple((number, T.tobytes()) for part, T in parts for number, _ in part.key)


class Placed(Prepared):
    """A cloud ``built`` in another frame than that of the model scan, which stands in it at
    ``T_built_target`` (4, 4): nothing of it is built again, and ``align`` is given what was built.
    """

    built: Prepared
    T_built_target: Array

    def __init__(self, built: Prepared, T_built_target: Array, key: TargetKey = ()) -> None:
        self.__dict__.update(
            built=built,
            T_built_target=T_built_target,
            planar=built.planar,
            native=None,  # it would be in another frame than `points`
            key=key or built.key,
        )

    @cached_property
    def points(self) -> Array:
        """(N, 3) m in the model scan's frame."""
        return transform(inverse(self.T_built_target), self.built.points)

    @property
    def size(self) -> int:
        return self.built.size

    def as_built(self, T_target_source: Array) -> tuple[Prepared, Array]:
        return self.built.as_built(self.T_built_target @ T_target_source)


class MapLimits(NamedTuple):
    """What a running map forgets: what lies farther than ``max_range`` m from the newest scan, and
    what none of the last ``horizon`` scans met. A library's map keeps to what it knows of these."""

    max_range: float
    horizon: int


class RunningMap(ABC):
    """A map of many scans in a frame of its own, kept up as their poses become known."""

    @abstractmethod
    def insert(self, scan: Prepared, T_map_scan: Array) -> None:
        """Add a scan at its pose (4, 4) and forget what is out of range or long unused."""

    @abstractmethod
    def target(self) -> Prepared:
        """What the next scan is registered to, in the map's frame."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """What a library says of one registration; None where it does not say.

    ``information`` is the (6, 6) information of a small motion d = (x, y, z, rx, ry, rz) in m and
    rad of the source in its own frame, T_target_source exp(d), in 1/m^2, 1/rad^2 and between.
    ``seconds`` is the method's own time, measured around ``align``; ``search_*`` say what a search
    before the method cost and gave (``search.base``).
    """

    T_target_source: Array
    converged: bool | None = None
    iterations: int | None = None
    information: Array | None = None
    library_fitness: float | None = None
    library_rmse: float | None = None
    seconds: float = 0.0
    search_seconds: float | None = None
    search_score: float | None = None
    search_peak_ratio: float | None = None


class Backend(ABC):
    """A registration method. ``max_correspondence_distance`` (m) is also the judge's radius
    unless ``judge_radius`` says otherwise; ``voxel_size`` (m, 0: off) thins every scan before the
    method sees it."""

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
        if not all_finite(points):
            raise BackendError(f"scan {scan.index}: some points are not finite")
        thinned = voxel_downsample(points, self.voxel_size)
        return self._prepared(thinned, scan.planar, ((scan.index, None),))

    def merge(
        self, parts: Sequence[tuple[Prepared, Array]], voxel_size: float | None = None
    ) -> Prepared:
        """One target out of several prepared scans, each with its T_target_part (4, 4), thinned by
        ``voxel_size`` m (None: as scans are)."""
        points = np.concatenate([transform(T, part.points) for part, T in parts])
        thinned = voxel_downsample(points, self.voxel_size if voxel_size is None else voxel_size)
        planar = all(part.planar for part, _ in parts)
        own = b"" if voxel_size is None else np.float64(voxel_size).tobytes()
        key = tuple((number, (T or b"") + own) for number, T in joined_key(parts))
        return self._prepared(thinned, planar, key)

    def join(self, parts: Sequence[tuple[Prepared, Array]]) -> Prepared:
        """As ``merge``, without the work that was done for each part where a backend can keep it:
        by default all points are prepared anew."""
        return self.merge(parts)

    def running_map(self, limits: MapLimits) -> RunningMap | None:
        """A new, empty map of the library's own kind; None: it is given points of one of ours."""
        return None

    def register(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        """Register source to target from the initial guess ``T_target_source`` (4, 4).

        Returns what ``align`` says, its motion float64 and, between planar scans, in the plane,
        its information symmetric. Raises ``TypeError`` or ``ValueError`` for a caller's mistake,
        ``BackendError`` if the library fails, and what a wrong plug-in raises as it is.
        """
        guess = _checked_guess(source, target, T_target_source)
        name = type(self).__name__
        built, start = target.as_built(guess)
        started = time.perf_counter()
        try:
            alignment = self.align(source, built, start)
        except BackendError as error:
            raise BackendError(one_line(error)) from error.__cause__
        except PROGRAMMING_ERRORS:
            raise
        except Exception as error:
            raise BackendError(f"{name}: {type(error).__name__}: {one_line(error)}") from error
        seconds = time.perf_counter() - started
        if built is not target:
            alignment = _from_built(target, alignment)
        return checked_alignment(self, alignment, source.planar and target.planar, seconds)

    def _prepared(self, points: Array, planar: bool, key: TargetKey) -> Prepared:
        if len(points) < MIN_POINTS:
            raise BackendError(
                f"scan {key[0][0]}: {len(points)} points: expected at least {MIN_POINTS}"
            )
        return Prepared(points, planar, self.build(points, planar), key)


def _from_built(target: Prepared, alignment: Any) -> Any:
    """An alignment to the cloud as it was built, in the target's frame."""
    if not isinstance(alignment, Alignment) or np.shape(alignment.T_target_source) != (4, 4):
        return alignment  # refused by `checked_alignment`
    T_target_built = inverse(target.as_built(np.eye(4))[1])
    return replace(alignment, T_target_source=T_target_built @ alignment.T_target_source)


def checked_alignment(
    backend: Backend, alignment: Any, planar: bool, seconds: float | None = None
) -> Alignment:
    """An alignment as a backend may return it, with arrays of its own, its motion in the plane for
    ``planar`` scans. Raises ``TypeError`` for what is none, ``BackendError`` for no motion."""
    name = type(backend).__name__
    if not isinstance(alignment, Alignment):
        kind = type(alignment).__name__
        raise TypeError(f"{name}.align returned {kind}: expected an Alignment")
    T = checked_motion(alignment.T_target_source, name, MAX_MOTION)
    iterations = alignment.iterations
    return Alignment(
        to_plane(T) if planar else T,
        # a library's own kind of bool would not be the `False` that checks look for
        None if alignment.converged is None else bool(alignment.converged),
        None if iterations is None else operator.index(iterations),
        _checked_information(alignment.information, planar),
        _number_or_none(alignment.library_fitness),
        _number_or_none(alignment.library_rmse),
        alignment.seconds if seconds is None else seconds,
        _number_or_none(alignment.search_seconds),
        _number_or_none(alignment.search_score),
        _number_or_none(alignment.search_peak_ratio),
    )


def checked_motion(given: Any, name: str, most: float = math.inf) -> Array:
    """A motion (4, 4) that ``name`` returned, a copy in float64. Raises ``BackendError`` for one
    that is not real, finite and rigid, or longer than ``most`` m."""
    try:
        plain = np.asarray(given)
    except ValueError:  # rows of different lengths
        raise BackendError(f"{name} returned no rigid motion") from None
    if plain.dtype.kind not in "fiu":
        raise BackendError(f"{name} returned no rigid motion: {plain.dtype.name}, not real numbers")
    T = np.array(plain, dtype=np.float64, order="C")
    if T.shape != (4, 4) or not rigidity(T) <= ANSWER_TOLERANCE:
        raise BackendError(f"{name} returned no rigid motion")
    length = math.hypot(T.item(3), T.item(7), T.item(11))
    if length > most:
        raise BackendError(f"{name} returned an implausible motion: {length:.3g} m > {most:g} m")
    return T


def _number_or_none(value: Any) -> float | None:
    return None if value is None else float(value)


def _checked_guess(source: Any, target: Any, T_target_source: Any) -> Array:
    """The guess as float64. Raises ``TypeError`` or ``ValueError`` for what is none."""
    for name, cloud in (("source", source), ("target", target)):
        if not isinstance(cloud, Prepared):
            kind = type(cloud).__name__
            raise TypeError(f"{name} is {kind}: expected what prepare() returns, a Prepared")
    try:
        guess = np.array(T_target_source, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise TypeError(f"T_target_source is no array of numbers: {error}") from error
    if guess.shape != (4, 4) or not rigidity(guess) <= GUESS_TOLERANCE:
        raise ValueError("the initial guess is not a rigid 4x4 motion")
    return guess


def _checked_information(given: Array | None, planar: bool) -> Array | None:
    """The information (6, 6), symmetric to the last bit, which a product of matrices is not on
    every processor; in the plane without what leaves it. Raises ``BackendError`` for other shapes.
    """
    if given is None:
        return None
    information = np.array(given, dtype=np.float64, order="C")
    if information.shape != (6, 6):
        raise BackendError(f"information {information.shape}: expected (6, 6)")
    return symmetric_information(information, planar)
