"""The nouns of the field, as small frozen records.

Units are metres, radians and seconds. Poses are 4x4 float64 and named by direction:
``T_target_source`` maps points of the source frame into the target frame.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.step_columns import STEPS

Array = NDArray[np.float64]


SCAN_ARRAYS = ("points", "ranges", "angles", "odometry", "ground_truth", "times")


def read_only(array: Array) -> Array:
    """A view of an array that cannot be written into; itself, if it cannot."""
    if isinstance(array, np.ndarray) and not array.flags.writeable:
        return array
    view = np.asarray(array).view()
    view.flags.writeable = False
    return view


@dataclass(frozen=True, eq=False)
class Scan:
    """One sensor reading.

    ``points`` (N, 3) m in the sensor frame, returns only. ``ranges`` and ``angles`` (B,) m and rad
    hold every beam in the order of sensing, NaN for a beam with no return; both are None for a
    cloud without beams. ``odometry`` and ``ground_truth`` are T_world_sensor, each in a world
    frame of its own. ``planar`` says that all points lie in z = 0 and motion stays in that plane.
    ``times`` (N,) s after ``stamp`` says when each point was taken; None where it is not known.
    """

    index: int
    stamp: float
    points: Array
    planar: bool = False
    ranges: Array | None = None
    angles: Array | None = None
    odometry: Array | None = None
    ground_truth: Array | None = None
    times: Array | None = None

    def copied(self) -> Scan:
        """The scan with arrays of its own."""
        return copy.deepcopy(self)

    def read_only(self) -> Scan:
        """The scan with arrays that nobody can write into by accident."""
        views: dict[str, Any] = {name: read_only(one) for name, one in self.arrays().items()}
        return replace(self, **views)

    def arrays(self) -> dict[str, Array]:
        """The arrays that it has, by name."""
        return {name: array for name in SCAN_ARRAYS if (array := getattr(self, name)) is not None}

    def without_truth(self) -> Scan:
        """The scan as a method may see it."""
        return self if self.ground_truth is None else replace(self, ground_truth=None)


@dataclass(frozen=True, eq=False)
class Node:
    """A scan with its pose: what guesses and targets may know of it.

    ``prepared`` is the backend's business and ``descriptor`` the similarity's; None if unused.
    ``hops`` counts the edges of the chain from the start to the scan, predicted ones included.
    ``covariance`` (6, 6) is what they add up to (``uncertainty.chained``), of a small motion d =
    (x, y, z, rx, ry, rz) in m and rad, T_world_scan exp(d); None unless the selector asks for it.
    """

    scan: int
    stamp: float
    T_world_scan: Array
    odometry: Array | None = None
    prepared: Any = None
    descriptor: NDArray[Any] | None = None
    hops: int = 0
    covariance: Array | None = None


@dataclass(frozen=True, eq=False)
class Localizability:
    """How well a registration's matched points hold the motion, whatever the method.

    ``matrix`` is the mean over inliers of j j^T with j = (n, p x n / lever): n the surface normal
    at the matched target point, p the source point, both in the source's frame; (3, 3) for
    x, y, rz in the plane, (6, 6) for x, y, z, rx, ry, rz in space. ``lever`` (m) is the inliers'
    RMS range, which makes every entry a share: an eigenvalue is the part of the points that
    oppose a motion along its eigenvector, 0 for a motion that the scan cannot see.
    """

    matrix: Array
    lever: float

    @cached_property
    def axes(self) -> tuple[Array, Array]:
        """Eigenvalues (D,), smallest first, and the unit eigenvectors (D, D) in columns."""
        values, vectors = np.linalg.eigh(self.matrix)
        return np.maximum(values, 0.0), vectors


@dataclass(frozen=True, eq=False)
class RegistrationResult:
    """One registration of a pair of scans: the backend's pose, judged.

    ``fitness`` (share of source points with a target point within the radius) and
    ``inlier_rmse`` (m, NaN without inliers) come from our own evaluator, the same for every
    backend; the library's own values are kept beside as ``library_*`` where it has any.
    ``converged`` and ``iterations`` are None where the library does not say.
    ``information`` is the method's own (6, 6) information of the motion, where it gives one (see
    ``Alignment``); ``localizability`` is ours, the same for all, None without 3 matched points
    on surfaces.
    """

    T_target_source: Array
    converged: bool | None
    fitness: float
    inlier_rmse: float
    inliers: int
    iterations: int | None = None
    seconds: float = 0.0
    information: Array | None = None
    library_fitness: float | None = None
    library_rmse: float | None = None
    localizability: Localizability | None = None
    search_seconds: float | None = None
    """What the search before the method took, part of ``seconds``; None without one."""
    search_score: float | None = None
    search_peak_ratio: float | None = None
    reused: bool = False
    """Not computed now but taken from memory or the pair store; ``seconds`` is what it took."""


@dataclass(frozen=True, eq=False)
class Edge:
    """A measured (or, for ``kind`` "predicted", assumed) motion between two scans.

    ``information`` (6, 6) is the method's own, ``covariance`` (6, 6) ours, only where a selector
    asks for it: both of a small motion of the scan in its own frame, T_model_scan exp(d).
    """

    model: int
    scan: int
    T_model_scan: Array
    information: Array | None = None
    kind: str = "registered"
    covariance: Array | None = None


class StepRecord:
    """One row of ``steps.parquet``: how a scan got its pose. Its fields are the columns that
    ``step_columns.STEPS`` declares, each with its default; kept as columns by ``StepTable``."""

    def __init__(self, scan: int, stamp: float, *values: Any, **named: Any) -> None:
        """``values`` in the order of the columns, ``named`` by their names."""
        self.scan, self.stamp = scan, stamp
        if values or named:
            given = {**dict(zip(_NAMES[2:], values, strict=False)), **named}
            if unknown := given.keys() - set(_NAMES):
                raise TypeError(f"no such columns of a step: {', '.join(sorted(unknown))}")
            self.__dict__.update(given)

    if TYPE_CHECKING:  # the names stand in STEPS alone

        def __getattr__(self, name: str) -> Any: ...
        def __setattr__(self, name: str, value: Any) -> None: ...

    def as_dict(self) -> dict[str, Any]:
        """The row by column."""
        return {name: getattr(self, name) for name in _NAMES}


_NAMES = tuple(column.name for column in STEPS)
for _column in STEPS:  # what a row does not say is the class's: most of a row is never set
    setattr(StepRecord, _column.name, _column.default)


class StepTable:
    """The rows of a run as columns, by name; ``add`` takes a row's values and forgets the row."""

    def __init__(self, records: Iterable[StepRecord] = ()) -> None:
        self.columns: dict[str, list[Any]] = {name: [] for name in _NAMES}
        for record in records:
            self.add(record)

    def __len__(self) -> int:
        return len(self.columns["scan"])

    def __getitem__(self, name: str) -> list[Any]:
        return self.columns[name]

    def add(self, record: StepRecord) -> None:
        """Append a row."""
        row = record.__dict__
        if unknown := row.keys() - _DEFAULTS.keys():
            raise TypeError(f"no such columns of a step: {', '.join(sorted(unknown))}")
        for name, values in self.columns.items():
            values.append(row[name] if name in row else _DEFAULTS[name])


_DEFAULTS = {column.name: column.default for column in STEPS}


@dataclass(frozen=True, eq=False)
class Step:
    """What the loop hands out for every scan: its row, its edges and the pose they give."""

    record: StepRecord
    edges: tuple[Edge, ...]
    T_world_scan: Array
