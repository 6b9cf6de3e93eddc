"""What the runs of a method are resampled and paired by.

A unit is an independent data set, known by its fingerprint: a seed of a simulated environment is
one, a log is one however often it was run. Within one log the units are its replicates, and of one
run the place-time clusters of its relations (rbtm_bench.report.intervals).
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from rbtm_bench.core.columns import is_cost
from rbtm_bench.core.types import Array
from rbtm_bench.metrics.relation_errors import FILE, RelationErrors
from rbtm_bench.report import better, frame, intervals
from rbtm_bench.report.better import REPLICATES, Comparison
from rbtm_bench.report.frame import MethodRuns
from rbtm_bench.report.intervals import Interval, Labels, Statistic
from rbtm_bench.report.margin import DEFAULT, Margin
from rbtm_bench.report.replicates import counted, data_set, number_of, value_of
from rbtm_bench.runs.stored import Run

DATA_SETS, CLUSTERS = "data sets", "clusters"

_OF_RELATIONS = re.compile(r"relations_(local_|long_)?(translation_mean_m|rotation_mean_deg)$")
"""Metrics that are the mean of an error of relations."""


@dataclass(frozen=True)
class Difference:
    """One metric of two methods on the same data: ``error`` and ``reference`` over what both
    have, ``interval`` of error - reference, ``unit`` what it was resampled by, ``p`` of the
    paired test or None. ``comparison``: by replicates, as ``better`` judges it."""

    error: float
    reference: float
    interval: Interval
    unit: str
    p: float | None
    comparison: Comparison | None = None


class Units:
    """The numbers of one method, by unit."""

    def __init__(self, method: MethodRuns) -> None:
        self.row, self._method = method.row, method
        self._done = [run for run in counted(method.runs) if run.done]

    def by_data_set(self, key: str) -> dict[str, float]:
        """The metric by data set; of several runs on the same data their median."""
        values: dict[str, list[float]] = {}
        for run in self._done:
            value = value_of(run, key)
            if value is not None:
                values.setdefault(data_set(run), []).append(value)
        return {name: float(np.median(numbers)) for name, numbers in values.items()}

    @cached_property
    def signatures(self) -> dict[str, str]:
        """All results by data set, as text: equal to the bit, they are of equal data."""
        results: dict[str, list[Any]] = {}
        for run in self._done:
            kept = {k: v for k, v in run.metrics.items() if not is_cost(k)}
            results.setdefault(data_set(run), []).append(kept)
        return {name: json.dumps(every, sort_keys=True) for name, every in results.items()}

    @cached_property
    def relations(self) -> RelationErrors | None:
        """The errors of every relation if all runs are on one log (of several runs their mean),
        and all have them: runs of older versions have not."""
        files = [run.path / FILE for run in self._done]
        if len({data_set(run) for run in self._done}) != 1 or not all(f.is_file() for f in files):
            return None
        of_runs = [RelationErrors.read(file) for file in files]
        if any(not np.array_equal(errors.start, of_runs[0].start) for errors in of_runs):
            return None
        translation = np.mean([errors.translation_m for errors in of_runs], axis=0)
        rotation = np.mean([errors.rotation_deg for errors in of_runs], axis=0)
        return replace(of_runs[0], translation_m=translation, rotation_deg=rotation)

    @cached_property
    def _clusters(self) -> Labels:
        errors = self.relations
        assert errors is not None
        return intervals.relation_clusters(errors.start, errors.end, errors.local)

    def _of_relations(self, key: str) -> Array | None:
        """The errors (R,) whose mean the metric is, NaN outside its group; None if it is none."""
        match, errors = _OF_RELATIONS.match(key), self.relations
        if match is None or errors is None:
            return None
        values = errors.rotation_deg if match[2].startswith("rotation") else errors.translation_m
        if match[1]:
            values = np.where(errors.local == (match[1] == "local_"), values, np.nan)
        return None if np.isnan(values).all() else values

    def estimate(self, key: str, statistic: Statistic) -> Interval | None:
        """The metric over all data sets, on one over its replicates; None if no run has it."""
        values = self.by_data_set(key)
        if len(values) == 1 and any(map(number_of, self._done)):
            every = [value_of(run, key) for run in self._done]
            return intervals.interval([v for v in every if v is not None], statistic)
        numbers = [values[name] for name in shared([self], key)]
        return intervals.interval(numbers, statistic) if numbers else None

    def clusters(self, key: str) -> Interval | None:
        """The mean of a log's relation errors, with the interval over their clusters."""
        errors, relations = self._of_relations(key), self.relations
        if errors is None or relations is None:
            return None
        return intervals.cluster_interval(errors, self._clusters, relations.local)

    def minus(self, other: Units, key: str, margin: Margin = DEFAULT) -> Difference | None:
        """This method's metric minus the other's, unit by unit; None if they share none."""
        compared = better.compare(self._method, other._method, key, margin)
        if compared is not None and compared.unit == REPLICATES:
            interval = intervals.interval(compared.pairs[0] - compared.pairs[1])
            medians = compared.ours, compared.theirs
            return Difference(*medians, interval, REPLICATES, compared.p, compared)
        ours, theirs = self.by_data_set(key), other.by_data_set(key)
        common = shared([self, other], key)
        if not common:
            return None
        if set(common) == set(ours) == set(theirs) and len(common) == 1:
            difference = self._minus_by_cluster(other, key)
            if difference:
                return difference
        a, b = (np.array([side[name] for name in common]) for side in (ours, theirs))
        off = _without_rounding(a, b)
        over, p = intervals.interval(off), intervals.signed_rank(off)
        return Difference(float(np.median(a)), float(np.median(b)), over, DATA_SETS, p)

    def _minus_by_cluster(self, other: Units, key: str) -> Difference | None:
        """The same over the relations of one log that both have an error of."""
        errors, others = self._of_relations(key), other._of_relations(key)
        relations = self.relations
        if errors is None or others is None or relations is None or len(errors) != len(others):
            return None
        off = _without_rounding(errors, others)
        both = ~np.isnan(off)
        if not both.any():
            return None
        over = intervals.cluster_interval(off, self._clusters, relations.local)
        means = float(errors[both].mean()), float(others[both].mean())
        return Difference(*means, over, CLUSTERS, None)


def _without_rounding(a: Array, b: Array) -> Array:
    """a - b, but 0 where they agree to nine digits: a test of signs does not see how little it
    is that two ways of the same computation differ."""
    return np.where(np.isclose(a, b, rtol=1e-9, atol=1e-12), 0.0, a - b)


def shared(methods: Sequence[Units], key: str) -> list[str]:
    """The independent data sets for which all methods have the metric: of those whose results
    are the same to the bit (seeds without any noise) the first."""
    values = [method.by_data_set(key) for method in methods]
    common = [name for name in values[0] if all(name in one for one in values)]
    first: dict[tuple[str, ...], str] = {}
    for name in common:
        first.setdefault(tuple(method.signatures[name] for method in methods), name)
    return list(first.values())


def methods_to_compare(runs: Sequence[Run], pool: bool) -> list[MethodRuns]:
    """The methods; with ``pool`` those that differ only in their data are one."""
    methods = frame.methods(runs)
    names = {method.row["data"] for method in methods}
    if not pool or len(names) < 2:
        return methods
    kinds = dict.fromkeys(str(method.row["dataset"]) for method in methods)
    name = f"{', '.join(kinds)} ({len(names)} pooled)"
    together: dict[str, list[MethodRuns]] = {}
    for method in methods:
        together.setdefault(method.runs[0].way, []).append(method)
    return [_pooled(group, name) for group in together.values()]


def _pooled(group: list[MethodRuns], name: str) -> MethodRuns:
    runs = [run for method in group for run in method.runs]
    done = sum(run.done for run in runs)
    status = "done" if done == len(runs) else f"{done} of {len(runs)} done"
    row = dict(group[0].row)
    for method in group[1:]:  # a metric may exist on some of the data only
        row.update({k: v for k, v in method.row.items() if row.get(k) is None})
    return MethodRuns({**row, "data": name, "seeds": len(runs), "status": status}, runs)


def grouped(methods: Sequence[MethodRuns], columns: Sequence[str]) -> list[list[MethodRuns]]:
    """The methods that agree in these columns; in "selector" with all its settings, unless those
    were chosen on other data (``held_out``)."""
    together: dict[tuple[Any, ...], list[MethodRuns]] = {}
    for method in methods:
        key = [method.row[column] for column in columns]
        if "selector" in columns and "chosen_on" not in method.row:
            key.append(method.runs[0].identity.part("selector"))
        together.setdefault(tuple(key), []).append(method)
    return list(together.values())
