"""What a study's runs say: the setting that other data chose, its regret, ratios with intervals.

A method's value is the median over its draws (seeds, or replicates of a log).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from rbtm_bench.core.types import Array
from rbtm_bench.report import better, held_out, intervals
from rbtm_bench.report.better import Comparison
from rbtm_bench.report.frame import MethodRuns
from rbtm_bench.report.margin import DEFAULT
from rbtm_bench.runs.stored import Run, is_number
from rbtm_bench.studies.plan import Draw, Method, Plan, read
from rbtm_bench.studies.study_file import OTHERS

LEAST = 1e-9
"""Errors below count as this much, so that a logarithm exists."""


@dataclass(frozen=True)
class Chosen:
    """The try that other data chose for a method. ``values``: every try's on the data shown (NaN:
    none), which is only looked at to say what the choice cost."""

    k: int
    tried: int
    values: tuple[float, ...]

    @property
    def regret(self) -> float:
        """Its error over that of the try that is best in hindsight."""
        known = [value for value in self.values if value == value]
        return self.values[self.k] / min(known) if known and min(known) > 0 else math.nan


@dataclass(frozen=True)
class Pooled:
    """A geometric mean ratio over backends, places of the axes and data sets; ends of its 95 %
    intervals with draws resampled within data sets, and with data sets resampled (None: fewer than
    three)."""

    ratio: float
    draws: tuple[float, float] | None
    places: tuple[float, float] | None
    n_places: int
    by_construction: int
    cells: int


@dataclass
class Outcome:
    """The finished runs of a plan below ``folder``."""

    plan: Plan
    folder: Path

    def __post_init__(self) -> None:
        self._read = cache(lambda name: read(self.folder / name))
        self.comparisons = cache(self._comparisons)

    def runs(self, method: Method, k: int, draws: Sequence[Draw]) -> list[Run]:
        """The runs of a try that were begun, failed ones among them."""
        names = (self.plan.names.get((method, k, draw)) for draw in draws)
        return [run for name in names if name and (run := self._read(name)) is not None]

    def tries(self, method: Method) -> int:
        """How many tries a method had."""
        return len(self.plan.study.tries(self.plan.study.ways[method.way]))

    def values(self, method: Method, k: int) -> dict[Draw, float]:
        """The errors of a try on the draws that are shown."""
        key, out = self.plan.study.metric, {}
        for draw in self.plan.shown:
            for run in self.runs(method, k, [draw]):
                value = run.metrics.get(key)
                if run.done and is_number(value) and value is not None and math.isfinite(value):
                    out[draw] = max(float(value), LEAST)
        return out

    def value(self, method: Method, k: int) -> float:
        known = list(self.values(method, k).values())
        return float(np.median(known)) if known else math.nan

    def mean_gap(self, method: Method, k: int) -> float:
        """Scans between a scan and its model scan, mean over scans and median over draws."""
        runs = self.runs(method, k, self.plan.shown)
        known = [run.metrics["mean_gap"] for run in runs if run.metrics.get("mean_gap")]
        return float(np.median(known)) if known else math.nan

    @cached_property
    def chosen(self) -> dict[Method, Chosen]:
        """Of every method the try that did best on the choosing data. A rotation of gaps has the
        choice of what it rotates: it is a test, not a method."""
        out: dict[Method, Chosen] = {}
        for method in self.plan.methods():
            way = self.plan.study.ways[method.way]
            is_test = way.like is not None and way.selector == "shifted_gap"
            of = method._replace(way=str(way.like)) if is_test else method
            values = tuple(self.value(method, k) for k in range(self.tries(method)))
            out[method] = Chosen(self.choice(of), len(values), values)
        return out

    def choice(self, method: Method) -> int:
        """The number of the try that did best on the choosing data."""
        study, tried = self.plan.study, self.tries(method)
        if tried == 1:
            return 0
        cells = {label: (name, at) for label, name, at, _ in study.cells()}
        name, at = cells[method.data]
        on = [method.data]
        if study.chosen_on == OTHERS:  # at the same place of the axes
            on = [c for c, (other, place) in cells.items() if other != name and place == at]
        settings = [
            held_out.Setting(
                {c: self.runs(method._replace(data=c), k, self.plan.choosing) for c in on}, {}
            )
            for k in range(tried)
        ]
        best, _ = held_out.best_of(settings, on, study.metric)
        return next((k for k, one in enumerate(settings) if one is best), 0)

    def method_runs(self, method: Method) -> MethodRuns:
        """The chosen try's runs, as comparisons take them."""
        runs = self.runs(method, self.chosen[method].k, self.plan.shown)
        whole = len(runs) == len(self.plan.shown) and all(run.done for run in runs)
        return MethodRuns({"status": "done" if whole else "failed"}, runs)

    def _comparisons(self, ours: str) -> dict[tuple[Method, str], Comparison]:
        """Of one way with every other, cell by cell; Holm over the others of a data set and
        backend, over the cells where there are axes."""
        comparisons: dict[tuple[Method, str], Comparison] = {}
        for method in self.plan.methods(ours):
            for other in self.others(ours):
                theirs = self.method_runs(method._replace(way=other))
                key = self.plan.study.metric
                one = better.compare(self.method_runs(method), theirs, key, DEFAULT)
                if one is not None:
                    comparisons[method, other] = one
        families: dict[object, list[tuple[Method, str]]] = {}
        for (method, other), _ in comparisons.items():
            family = (method.backend, other if self.plan.study.axes else method.data)
            families.setdefault(family, []).append((method, other))
        for members in families.values():
            adjusted = better.adjusted([comparisons[member] for member in members])
            comparisons.update(zip(members, adjusted, strict=True))
        return comparisons

    def others(self, ours: str) -> list[str]:
        """What a way is compared with: every other, of rotations its own."""
        ways = self.plan.study.ways
        return [
            n
            for n, w in ways.items()
            if n != ours and (w.selector != "shifted_gap" or w.like == ours)
        ]

    def pooled(self, ours: str, other: str) -> Pooled | None:
        """The ratio of a way's errors to another's: geometric mean over draws, backends and places
        of the axes, then data sets. None without any. Places of one data set share its draws: they
        are resampled together, and say nothing of another data set."""
        places: dict[str, list[Array]] = {}
        data_set = {label: name for label, name, _, _ in self.plan.study.cells()}
        equal = cells = 0
        for method in self.plan.methods(ours):
            logs = self._log_ratios(method, method._replace(way=other))
            places.setdefault(data_set[method.data], []).append(logs)
            cells += 1
            equal += not np.nan_to_num(logs).any() and not np.isnan(logs).all()
        matrices = [np.stack(of_backends) for of_backends in places.values()]
        known = [m[:, ~np.isnan(m).all(axis=0)] for m in matrices]
        per_place = [np.nanmean(m, axis=0) for m in known if m.size]
        if not per_place:
            return None
        rng = np.random.default_rng(intervals.SEED)
        means = np.array([draws.mean() for draws in per_place])
        resampled = [d[rng.integers(0, len(d), (intervals.RESAMPLES, len(d)))] for d in per_place]
        of_draws = np.mean([r.mean(axis=1) for r in resampled], axis=0)
        few = min(map(len, per_place)) < intervals.FEWEST_UNITS
        ends = [0.025, 0.975]
        over_draws = None if few else tuple(np.exp(np.quantile(of_draws, ends)))
        over_places = None
        if len(means) >= intervals.FEWEST_UNITS:
            drawn = rng.integers(0, len(means), (intervals.RESAMPLES, len(means)))
            over_places = tuple(np.exp(np.quantile(means[drawn].mean(axis=1), ends)))
        ratio = float(np.exp(means.mean()))
        return Pooled(ratio, over_draws, over_places, len(means), equal, cells)

    def _log_ratios(self, ours: Method, theirs: Method) -> Array:
        """By draw (n,), NaN where either has none."""
        a, b = (self.values(m, self.chosen[m].k) for m in (ours, theirs))
        return np.array(
            [math.log(a[d] / b[d]) if d in a and d in b else math.nan for d in self.plan.shown]
        )

    @property
    def failed(self) -> dict[str, str]:
        """Why runs failed, by name."""
        runs = {name: self._read(name) for name in dict.fromkeys(self.plan.names.values())}
        return {n: str(r.record.get("reason")) for n, r in runs.items() if r and not r.done}
