"""The placebo margin: the ratio that settings which nobody would tell apart reach on a log."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rbtm_bench.core.errors import RbtmBenchError
from rbtm_bench.core.kinds import Nuisance
from rbtm_bench.report.frame import MethodRuns
from rbtm_bench.report.replicates import Spread, data_set, spread
from rbtm_bench.runs.identity import node_key
from rbtm_bench.runs.replicate import nuisances

QUANTILE = 0.95
NEAR = {Nuisance.DISTANCE: 0.25, Nuisance.THRESHOLD: 0.03}
"""Neighbours: log ratio of distances (.44 and .56 m), difference of thresholds (.88 and .91)."""
FEWEST_PAIRS = 20
"""Of fewer neighbours a 95 % quantile is their largest, or less."""


@dataclass(frozen=True)
class Margin:
    """``factor``: medians whose ratio is not beyond it may differ by luck; ``source``: by what
    that was measured."""

    factor: float
    source: str


DEFAULT = Margin(2.0, "default, of scripts/benchmarks/placebo.py; this log's own is not measured")
"""A choice, not a quantile: six cells of MIT CSAIL and ACES reach 1.13 to 4.33, all their 126 pairs
3.03. Beyond 2 a placebo is called different in one of the six, and 4 times the error is still found
with 10 replicates; at 3 the latter fails (docs/statistics.md)."""


def margin_of(methods: Sequence[MethodRuns], key: str) -> Margin:
    """This log's margin by an error, from the neighbouring settings among ``methods`` (all on one
    data set), the default if there are too few."""
    known: list[tuple[MethodRuns, Spread]] = []
    for method in methods:
        over = spread(method.runs, key)
        if over is not None and over.median > 0:
            known.append((method, over))
    ratios = [abs(np.log(a.median / b.median)) for a, b in _neighbours(known)]
    if len(ratios) < FEWEST_PAIRS:
        return DEFAULT
    factor = float(np.exp(np.quantile(ratios, QUANTILE)))
    return Margin(factor, f"{len(ratios)} pairs of neighbouring settings of this table")


def _neighbours(known: Sequence[tuple[MethodRuns, Spread]]) -> list[tuple[Spread, Spread]]:
    """Pairs of methods that differ in one nuisance setting, by little."""
    groups: dict[str, list[tuple[float, Nuisance, Spread]]] = {}
    for method, over in known:
        run = method.runs[0]
        settings = {**run.choices, **run.identity.what}
        for name, value, nuisance in _of(run.config):
            if name in settings:
                others = {k: v for k, v in settings.items() if k != name}
                groups.setdefault(node_key(data_set(run), name, others), []).append(
                    (value, nuisance, over)
                )
    pairs = []
    for group in groups.values():
        for (a, kind, one), (b, _, other) in itertools.combinations(group, 2):
            apart = abs(a - b) if kind is Nuisance.THRESHOLD else abs(np.log(a / b)) if a * b else 1
            if 0 < apart <= NEAR[kind]:
                pairs.append((one, other))
    return pairs


def _of(config: dict[str, Any]) -> list[tuple[str, float, Nuisance]]:
    """The nuisance settings of a stored run; none of a plug-in that is not here any more."""
    try:
        return list(nuisances(config))
    except RbtmBenchError:
        return []
