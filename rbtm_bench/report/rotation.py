"""Does it matter *when* rbtm reaches back? Its run against rotations of its own gaps, and which
rows are no controls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rbtm_bench.report.frame import MethodRuns
from rbtm_bench.report.render import is_numeric_cell, three_digits
from rbtm_bench.report.replicates import SHIFTED, trajectory_of, value_of
from rbtm_bench.runs.stored import Run

RBTM = ("rbtm", "rbtm_verified")


@dataclass(frozen=True)
class Rotation:
    """An error of a run of rbtm, ``ours``, beside those of its rotations (n,)."""

    backend: str
    ours: float
    rotated: tuple[float, ...]
    distinct: int
    tries: int

    @property
    def p(self) -> float:
        """One-sided, exact: (1 + rotations at least as good) / (1 + n). Under "when does not
        matter" the run is one of n + 1 that nothing tells apart."""
        as_good = sum(value <= self.ours * (1 + 1e-9) for value in self.rotated)
        return (1 + as_good) / (1 + len(self.rotated))

    def words(self) -> str:
        q1, median, q3 = np.quantile(self.rotated, [0.25, 0.5, 0.75])
        if min(q1, self.ours) > 0:
            ratio = three_digits(self.ours / median)
            ends = f"{three_digits(self.ours / q3)} - {three_digits(self.ours / q1)}"
            words = f"{self.backend} {self.p:.2g}, {ratio} [{ends}]"
        else:
            words = f"{self.backend} {self.p:.2g}"
        if self.distinct < len(self.rotated):
            words += f" ({self.distinct} distinct)"
        return words + (f" (best of {self.tries}: p too small)" if self.tries > 1 else "")


def of_methods(group: Sequence[MethodRuns], key: str) -> list[Rotation]:
    """The tests that the runs on one data set allow."""
    tests = []
    for method in group:
        if method.row["selector"] != SHIFTED:
            continue
        runs = [run for run in method.runs if run.done and value_of(run, key) is not None]
        backend = str(method.row["backend"])
        ours = [m for m in group if m.row["backend"] == backend and m.row["selector"] in RBTM]
        own = next((run for m in ours for run in m.runs if runs and _is_source(run, runs[0])), None)
        if own is None or (value := value_of(own, key)) is None:
            continue
        rotated = tuple(v for run in runs if (v := value_of(run, key)) is not None)
        distinct = len({trajectory_of(run) for run in runs})
        tests.append(Rotation(backend, value, rotated, distinct, len(ours)))
    return tests


def line(group: Sequence[MethodRuns], key: str) -> list[str]:
    """All of them in a line; nothing if there are none."""
    tests = of_methods(group, key)
    if not tests:
        return []
    most = max(len(test.rotated) for test in tests)
    head = f"when rbtm reached back (p, ratio to the median of {most} rotations of its gaps)"
    return [f"{head}: {'; '.join(test.words() for test in tests)}"]


def _is_source(run: Run, rotated: Run) -> bool:
    """Whether a run is the one whose gaps were rotated; its folder may have been moved with it."""
    name = Path(str(rotated.section("selector").get("gaps_from"))).name
    together = run.path.resolve().parent == rotated.path.resolve().parent
    return run.done and together and run.path.name == name


def is_previous(row: Mapping[str, Any]) -> bool:
    """Whether a keyframe rule took the scan before every time: that is no control."""
    gap = row.get("mean_gap")
    return row["selector"] == "keyframe" and is_numeric_cell(gap) and gap == 1
