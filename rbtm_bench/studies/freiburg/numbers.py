"""The numbers of scripts/freiburg_table.py, from the folders of its runs alone."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from rbtm_bench.metrics.relation_errors import FILE, RelationErrors
from rbtm_bench.report import frame, held_out, intervals
from rbtm_bench.report.frame import MethodRuns
from rbtm_bench.report.intervals import Interval
from rbtm_bench.report.units import Units
from rbtm_bench.runs.stored import Run
from rbtm_bench.studies.freiburg.plan import LOGS, NOTHING, OF_SYSTEM, SYSTEM, WAYS

ERRORS = {
    "mean_m": "relations_translation_mean_m",
    "local_m": "relations_local_translation_mean_m",
    "long_m": "relations_long_translation_mean_m",
    "mean_deg": "relations_rotation_mean_deg",
    "local_deg": "relations_local_rotation_mean_deg",
    "long_deg": "relations_long_rotation_mean_deg",
}
"""Columns with an interval, and the metrics they show."""
PLAIN = ("coverage", "mean_gap", "ms_per_scan")
WITHIN = {"mean_m": "all", "local_m": "local", "long_m": "long"}
"""The errors that methods are compared by."""
CONTROL_WAYS = (NOTHING, *(way.selector for way in WAYS if way.selector != "rbtm"))
ORDER = (NOTHING, *(way.selector for way in WAYS), SYSTEM)

SETTINGS = {
    "registration.max_correspondence_distance": "distance {:g} m",
    "selector.distance": "a keyframe every {:g} m",
    "selector.gap": "gap {:g}",
    "selector.threshold": "threshold {:g}",
    "backend.voxel_size": "voxels of {:g} m",
}

Key = tuple[str, str, str]
"""Log, backend and way."""


def log_of(run: Run) -> str:
    """The log of a run, by its name."""
    name = run.path.name
    return next(log for log in LOGS if name.startswith(f"{log}-"))


def choose(runs: Sequence[Run]) -> dict[Key, MethodRuns]:
    """Of every log, backend and way the setting that did best on the other logs."""
    logs = {str(method.row["data"]): log_of(method.runs[0]) for method in frame.methods(runs)}
    chosen: dict[Key, MethodRuns] = {}
    for method in held_out.leave_one_out(runs):
        backend = str(method.row["backend"])
        way = backend if backend in (NOTHING, SYSTEM) else str(method.row["selector"])
        chosen[logs[method.row["data"]], backend, way] = method
    return dict(sorted(chosen.items(), key=lambda item: _rank(item[0])))


def _rank(key: Key) -> tuple[Any, ...]:
    log, backend, way = key
    place = 0 if backend == NOTHING else 2 if backend == SYSTEM else 1
    return list(LOGS).index(log), place, backend, ORDER.index(way)


def setting(key: Key, method: MethodRuns) -> str:
    """The setting in words, by the number of the try in the run's name."""
    _, backend, way = key
    if backend == NOTHING or not method.runs:
        return ""
    k = int(method.runs[0].path.name.rpartition("-")[2]) - 1
    used = OF_SYSTEM if backend == SYSTEM else next(w for w in WAYS if w.selector == way)
    return SETTINGS[used.knob].format(used.values[k])


def table(chosen: Mapping[Key, MethodRuns]) -> pd.DataFrame:
    """A row a log, backend and way: the setting, how it was chosen, errors with intervals."""
    rows = []
    for key, method in chosen.items():
        log, backend, way = key
        row: dict[str, Any] = {"log": LOGS[log], "backend": backend, "way": way}
        row["setting"] = setting(key, method)
        row |= {name: method.row[name] for name in ("tried", "equal")}
        others = [LOGS[name] for name in LOGS if name != log]
        row["chosen_on"] = ", ".join(others) if method.row["tried"] > 1 else ""
        row["status"] = _status(method)
        units = Units(method)
        for name, metric in ERRORS.items():
            estimate = units.clusters(metric) or units.estimate(metric, "mean")
            row[name] = estimate.value if estimate else math.nan
            row[f"{name}_low"] = math.nan if not estimate or estimate.low is None else estimate.low
            row[f"{name}_high"] = (
                math.nan if not estimate or estimate.high is None else estimate.high
            )
            row[f"{name}_n"] = estimate.n if estimate else 0
        row |= {name: method.row.get(name) for name in PLAIN}
        row["reason"] = (
            method.runs[0].record.get("reason") if method.runs else "no number to choose by"
        )
        rows.append(row)
    return pd.DataFrame(rows)


def transfer(chosen: Mapping[Key, MethodRuns], runs: Sequence[Run]) -> pd.DataFrame:
    """What choosing elsewhere costs: by log and way the geometric mean over backends of the error
    of the setting chosen on the other logs over that of the best try on this one."""
    by_stem: dict[str, list[float]] = {}
    for run in runs:
        error = run.metrics.get(ERRORS["mean_m"]) if run.done else None
        if error:
            by_stem.setdefault(run.path.name.rpartition("-")[0], []).append(float(error))
    logs: dict[tuple[str, str], list[float]] = {}
    for (log, backend, way), method in chosen.items():
        tries = by_stem.get(f"{log}-{backend}-{way}", [])
        error = method.row.get(ERRORS["mean_m"])
        if backend not in (NOTHING, SYSTEM) and error and tries:
            logs.setdefault((log, way), []).append(math.log(error / min(tries)))
    return pd.DataFrame(
        [
            {
                "log": LOGS[log],
                "way": way,
                "backends": len(logarithms),
                "times": math.exp(np.mean(logarithms)),
            }
            for (log, way), logarithms in logs.items()
        ],
        columns=["log", "way", "backends", "times"],
    )


SMALL = ("log", "backend", "way", "setting", "tried", "equal", "chosen_on", "status")


def small(table: pd.DataFrame) -> pd.DataFrame:
    """The table with four digits, without times: they depend on the machine's mood."""
    names = [c for c in table if str(c).startswith(tuple(ERRORS)) or c in ("coverage", "mean_gap")]
    rounded = table[[*SMALL, *names]].copy()
    for name in (name for name in names if not str(name).endswith("_n")):
        values = rounded[name].astype(float)
        rounded[name] = [v if math.isnan(v) else float(f"{v:.4g}") for v in values]
    return rounded


def _status(method: MethodRuns) -> str:
    return "done" if method.runs and all(run.done for run in method.runs) else "failed"


def differences(chosen: Mapping[Key, MethodRuns], backends: Iterable[str]) -> pd.DataFrame:
    """RBTM minus each control on every log, with every backend: over the relations that both
    have, resampled by cluster. ``verdict`` is "better" or "worse" where the interval excludes 0,
    else "": and nothing where either has failed."""
    rows = []
    units = {key: Units(method) for key, method in chosen.items()}
    for log, backend, control in [(g, b, c) for g in LOGS for b in backends for c in CONTROL_WAYS]:
        ours, theirs = _pair(log, backend, control)
        for name, which in WITHIN.items():
            row: dict[str, Any] = {"log": LOGS[log], "backend": backend, "control": control}
            row["relations"] = which
            both_known = ours in units and theirs in units
            difference = units[ours].minus(units[theirs], ERRORS[name]) if both_known else None
            over = difference.interval if difference else Interval(math.nan, None, None, 0)
            row |= {"rbtm_m": difference.error if difference else math.nan}
            row |= {"control_m": difference.reference if difference else math.nan}
            row |= {"ratio": _ratio(row["rbtm_m"], row["control_m"]), "difference_m": over.value}
            row |= {"low": _number(over.low), "high": _number(over.high), "n": over.n}
            row["verdict"] = ("better" if over.value < 0 else "worse") if over.excludes(0) else ""
            rows.append(row)
    return pd.DataFrame(rows)


def _pair(log: str, backend: str, control: str) -> tuple[Key, Key]:
    """The keys of RBTM and of a control."""
    theirs = (log, NOTHING, NOTHING) if control == NOTHING else (log, backend, control)
    return (log, backend, "rbtm"), theirs


def _ratio(ours: float, theirs: float) -> float:
    return ours / theirs if theirs else math.nan


def _number(value: float | None) -> float:
    return math.nan if value is None else value


@dataclass(frozen=True)
class _Sums:
    """Per stratum its share of the relations, and by cluster the number of relations and the sums
    of the errors of RBTM and the control by backend."""

    share: float
    counts: np.ndarray[Any, Any]
    ours: np.ndarray[Any, Any]
    theirs: np.ndarray[Any, Any]


def pooled(chosen: Mapping[Key, MethodRuns], backends: Iterable[str]) -> pd.DataFrame:
    """Over all backends: the geometric mean of RBTM's mean relation error over the control's, on
    every log, with a percentile interval over its clusters (drawn within local and long)."""
    rows = []
    for log, control in [(g, c) for g in LOGS for c in CONTROL_WAYS]:
        pairs = []
        for backend in backends:
            keys = _pair(log, backend, control)
            runs = [chosen[key].runs for key in keys if key in chosen]
            if len(runs) == 2 and all(
                r and r[0].done and (r[0].path / FILE).is_file() for r in runs
            ):
                pairs.append([RelationErrors.read(r[0].path / FILE) for r in runs])
        for which in WITHIN.values():
            ratio = geometric_ratio(pairs, which)
            row: dict[str, Any] = {"log": LOGS[log], "control": control, "relations": which}
            row |= {"ratio": ratio.value, "low": _number(ratio.low), "high": _number(ratio.high)}
            row |= {"clusters": ratio.n, "backends": len(pairs)}
            row["verdict"] = ("better" if ratio.value < 1 else "worse") if ratio.excludes(1) else ""
            rows.append(row)
    return pd.DataFrame(rows)


def geometric_ratio(pairs: Sequence[Sequence[RelationErrors]], which: str = "all") -> Interval:
    """The geometric mean over pairs (ours, theirs) of mean(ours) / mean(theirs), on the
    relations ("all", "local", "long") of which all have an error."""
    nothing = Interval(math.nan, None, None, 0)
    if not pairs:
        return nothing
    one = pairs[0][0]
    used = np.all([errors.used for pair in pairs for errors in pair], axis=0)
    if which != "all":
        used &= one.local == (which == "local")
    if not used.any():
        return nothing
    ours, theirs = (np.array([p[side].translation_m[used] for p in pairs]).T for side in (0, 1))
    labels = intervals.relation_clusters(one.start, one.end, one.local)[used]
    strata = []
    for kind in np.unique(one.local[used]):
        inside = one.local[used] == kind
        names, number = np.unique(labels[inside], return_inverse=True)
        to_sum = (number == np.arange(len(names))[:, None]).astype(np.float64)
        sums = to_sum @ ours[inside], to_sum @ theirs[inside]
        strata.append(_Sums(float(inside.mean()), to_sum.sum(axis=1), *sums))
    n = sum(len(s.counts) for s in strata)
    value = float(_mean_ratio(strata, [np.ones((1, len(s.counts))) for s in strata])[0])
    if min(len(s.counts) for s in strata) < intervals.FEWEST_UNITS:
        return Interval(value, None, None, n)
    rng = np.random.default_rng(intervals.SEED)
    drawn = [
        rng.multinomial(
            len(s.counts), np.full(len(s.counts), 1 / len(s.counts)), intervals.RESAMPLES
        )
        for s in strata
    ]
    tail = (1 - intervals.LEVEL) / 2
    low, high = np.quantile(_mean_ratio(strata, drawn), [tail, 1 - tail])
    return Interval(value, float(low), float(high), n)


def _mean_ratio(strata: Sequence[_Sums], times: Sequence[np.ndarray[Any, Any]]) -> Any:
    """The ratio (K,) for K times that each cluster was drawn: ``times`` (K, clusters)."""
    ours = theirs = 0.0
    for s, t in zip(strata, times, strict=True):
        count = (t @ s.counts)[:, None]
        ours = ours + s.share * (t @ s.ours) / count
        theirs = theirs + s.share * (t @ s.theirs) / count
    return np.exp(np.log(ours / theirs).mean(axis=1))
