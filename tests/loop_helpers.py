"""A fake backend, scripted scores and a short drive, for tests of the loop."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from rbtm_bench.backends.base import Alignment, Backend, Prepared
from rbtm_bench.check.base import Check
from rbtm_bench.check.gated import Gated
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import inverse, se2, transform
from rbtm_bench.core.types import Array, Scan, Step
from rbtm_bench.guess.base import Guess
from rbtm_bench.guess.odometry import Odometry
from rbtm_bench.odometry.method import Method
from rbtm_bench.selection.base import Selector
from rbtm_bench.selection.previous import Previous
from rbtm_bench.similarity.base import Similarity
from rbtm_bench.target.base import Target
from rbtm_bench.target.single import SingleScan

NAN = float("nan")

Pair = tuple[int, int]


def true_pose(scan: int) -> Array:
    return se2(0.1 * scan, 0.02 * scan**2, 0.05 * scan)


PLACE = np.random.default_rng(0).uniform(-5.0, 5.0, (10, 3))
"""What every scan sees, m."""


def drive(count: int, first: int = 0) -> list[Scan]:
    """Scans whose odometry creeps away from the truth by 1 % of x."""
    shrunk = [true_pose(i) for i in range(first, first + count)]
    for T in shrunk:
        T[0, 3] *= 0.99
    return [
        Scan(first + i, 0.1 * i, transform(inverse(true_pose(first + i)), PLACE), odometry=T)
        for i, T in enumerate(shrunk)
    ]


class Perfect(Backend):
    """Knows the true motion. ``fails``: pairs it raises on, ``lost``: pairs it does not converge
    on, ``unusable``: scans it cannot prepare. Keeps (model, scan, guess) of every call."""

    def __init__(
        self, fails: Iterable[Pair] = (), lost: Iterable[Pair] = (), unusable: Iterable[int] = ()
    ) -> None:
        super().__init__()
        self.fails, self.lost, self.unusable = set(fails), set(lost), set(unusable)
        self.calls: list[tuple[int, int, Array]] = []

    def build(self, points: Array, planar: bool) -> Any:
        raise NotImplementedError

    def prepare(self, scan: Scan) -> Prepared:
        if scan.index in self.unusable:
            raise BackendError(f"scan {scan.index}: 2 points")
        return Prepared(scan.points, scan.planar, scan.index)

    def merge(self, parts: Any) -> Prepared:
        raise BackendError("no maps here")

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        model, scan = int(target.native), int(source.native)
        self.calls.append((model, scan, T_target_source))
        if (model, scan) in self.fails:
            raise BackendError("the library raised")
        T = inverse(true_pose(model)) @ true_pose(scan)
        converged = (model, scan) not in self.lost
        return Alignment(T, converged, iterations=3, library_fitness=0.8)

    @property
    def tried(self) -> list[Pair]:
        return [(model, scan) for model, scan, _ in self.calls]


class Script(Similarity):
    """Scores out of a table (model, scan) -> S, else ``otherwise``."""

    def __init__(self, table: dict[Pair, float] | None = None, otherwise: float = NAN) -> None:
        self.table, self.otherwise = table or {}, otherwise
        self.described: list[int] = []

    def describe(self, scan: Scan) -> Array:
        self.described.append(scan.index)
        return np.array([float(scan.index)])

    def scores(self, window: Array, descriptor: Array) -> Array:
        pairs = [(int(model), int(descriptor[0])) for model in window[:, 0]]
        return np.array([self.table.get(pair, self.otherwise) for pair in pairs])


def method(
    backend: Backend | None = None,
    selector: Selector | None = None,
    similarity: Similarity | None = None,
    guess: Guess | None = None,
    check: Check | None = None,
    target: Target | None = None,
) -> Method:
    return Method(
        backend or Perfect(),
        similarity or Script(otherwise=0.9),
        selector or Previous(),
        guess or Odometry(),
        check or Gated(0.3, 1e3, 180.0),
        target or SingleScan(),
    )


def rows(steps: list[Step]) -> list[tuple[str, int | None]]:
    return [(step.record.status, step.record.model) for step in steps]
