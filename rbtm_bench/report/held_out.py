"""Settings chosen on other data than those shown.

The best of many settings on the data that chose it is lucky as well as good. So a setting is
chosen by its score on choosing data, for every backend and selector apart, and its runs on the
data shown are the row. The score is the mean, over choosing data sets, of the mean logarithm of
the main error (``best_settings.ERRORS``) of their runs: a ratio counts the same on data of
millimetres and on data of metres, and one bad data set does not decide alone.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean, median
from typing import TYPE_CHECKING, Any

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.report import best_settings, frame
from rbtm_bench.report.frame import METHOD, MethodRuns
from rbtm_bench.report.replicates import counted, number_of
from rbtm_bench.runs.stored import Run, is_number

if TYPE_CHECKING:
    import pandas as pd

LEAST = 1e-12
"""Errors below count as this much, so that a logarithm exists."""

FEW = 3
"""Names of choosing data sets that a row lists at most."""

CHOICE_COLUMNS = ("tried", "equal", "left_out", "chosen_on")
"""What a row says of its choice: settings it was chosen from, those of them with the very same
score, those that were not run on all of the data, and where it was chosen."""

RULE = (
    "each setting was chosen on other data (chosen_on): the least mean logarithm of the main error "
    "on it; one with a failed run only where all have one; of equal ones the first"
)


@dataclass
class Setting:
    """The runs of one setting by name of the data set: those that choose, those that are shown."""

    choosing: dict[str, list[Run]]
    shown: dict[str, list[Run]]


Groups = dict[tuple[Any, Any], dict[str, Setting]]
"""By backend and selector the settings, by what they are apart from the data."""


def leave_one_out(runs: Sequence[Run]) -> list[MethodRuns]:
    """For every data set, backend and selector the setting that did best on the other data sets,
    with its runs on this one.

    Rows have ``CHOICE_COLUMNS`` besides the usual ones. Where none of several settings can be
    chosen (no other data, or no number on them) the row names none and has no runs.

    Raises ``ConfigError`` if all runs are on one data set.
    """
    sorted_runs = _Sorted(runs, runs)
    names = sorted_runs.shown
    if len(names) < 2:
        raise ConfigError(
            f"--held-out: all runs are on one data set ({names[0]}): expected several, or name "
            "what chooses, e.g. --choose-on seed=100,101,102"
        )
    label = _labels(names)
    chosen = []
    for data in names:
        for _, settings in sorted_runs.on(data):
            run_on = {name for one in settings.values() for name in one.choosing} - {data}
            others = [name for name in names if name in run_on]
            words = ", ".join(label[name] for name in others)
            words = f"{len(others)} other data sets" if len(others) > FEW else words
            chosen.append(_choose(sorted_runs, settings, data, others, words))
    return frame.by_data_and_backend(chosen)


def choose_on(runs: Sequence[Run], key: str, values: Sequence[str]) -> list[MethodRuns]:
    """The same with settings chosen on the runs whose ``key`` has one of the values; the others
    are shown. ``key`` is "seed" or a setting ("dataset.environment", or "environment" alone).

    The runs that choose for a data set are those on a data set of that name (other seeds of a
    place), or else all of them.

    Raises ``ConfigError`` for a key or a value that no run has, if nothing is left to show, and if
    runs that choose are on the very data that others show (a log has no seeds).
    """
    words = f"{key}={','.join(values)}"
    choosing, shown = _split(runs, key, values, words)
    twice = {fingerprint(run) for run in choosing} & {fingerprint(run) for run in shown} - {None}
    if twice:
        same = next(run for run in shown if fingerprint(run) in twice)
        raise ConfigError(
            f"--choose-on {words}: settings would be chosen on the very data of {same.path.name}, "
            f"which is shown ({key} does not change the data): expected runs on other data"
        )
    sorted_runs = _Sorted(choosing, shown)
    chosen = []
    for data in sorted_runs.shown:
        for _, settings in sorted_runs.on(data):
            run_on = list(dict.fromkeys(d for one in settings.values() for d in one.choosing))
            own = [data] if data in run_on else run_on
            chosen.append(_choose(sorted_runs, settings, data, own, words))
    return frame.by_data_and_backend(chosen)


def fingerprint(run: Run) -> str | None:
    """Of the run's data; None if it is not known."""
    recorded = run.record.get("dataset_fingerprint")
    return str(recorded) if recorded else None


def parse(word: str) -> tuple[str, list[str]]:
    """KEY=A,B as the key and its values. Raises ``ConfigError`` for anything else."""
    key, equals, rest = word.partition("=")
    values = [value.strip() for value in rest.split(",") if value.strip()]
    if not (equals and key.strip() and values):
        raise ConfigError(f"--choose-on {word}: expected KEY=VALUES, e.g. seed=100,101,102")
    return key.strip(), values


def chosen_table(chosen: Sequence[MethodRuns]) -> pd.DataFrame:
    """A row a data set, backend and selector; within a backend by the main error."""
    import pandas as pd

    rows = pd.DataFrame([method.row for method in chosen])
    parts = []
    for _, on_data in rows.groupby("data", sort=False, dropna=False):
        error = best_settings.main_error(on_data)
        for _, methods in on_data.groupby("backend", sort=False, dropna=False):
            parts.append(methods.sort_values(error[0], kind="stable") if error else methods)
    return pd.concat(parts, ignore_index=True)


def chosen_columns(table: pd.DataFrame) -> tuple[list[str], list[str]]:
    """The columns to show of the table; of these the main errors."""
    names, main = best_settings.best_columns(table)
    return [*names, "chosen_on"], main


def choice_notes(chosen: Sequence[MethodRuns]) -> list[str]:
    """The notes beside a table of settings chosen on other data."""
    import pandas as pd

    rows = pd.DataFrame([method.row for method in chosen])
    lines = [RULE] if rows["tried"].max() > 1 else []
    rows["data"] = rows["data"].map(_labels([str(name) for name in rows["data"].unique()]))
    lines += best_settings.equal_chances(rows)
    out = int(rows["left_out"].max())
    if out:
        settings = "1 setting was" if out == 1 else f"up to {out} settings of a method were"
        lines.append(f"{settings} left out: not run on all of the data")
    none = int(sum(not method.runs for method in chosen))
    if none:
        rows_of = "1 row names no setting" if none == 1 else f"{none} rows name no setting"
        lines.append(f"{rows_of}: no number on other data to choose by")
    return lines


def pooled(chosen: Sequence[MethodRuns]) -> list[MethodRuns]:
    """The methods with the rows of all data sets as one, whatever setting each of them has."""
    names = dict.fromkeys(str(method.row["data"]) for method in chosen)
    kinds = dict.fromkeys(str(method.row["dataset"]) for method in chosen)
    if len(names) < 2:
        return list(chosen)
    together: dict[tuple[Any, Any], list[MethodRuns]] = {}
    for method in chosen:
        if method.runs:
            key = (method.row["backend"], method.row["selector"])
            together.setdefault(key, []).append(method)
    name = f"{', '.join(kinds)} ({len(names)} pooled)"
    return [_pooled(group, name) for group in together.values()]


def _pooled(group: Sequence[MethodRuns], name: str) -> MethodRuns:
    row = dict(group[0].row)
    for method in group[1:]:
        for key in (*METHOD, *CHOICE_COLUMNS):
            if row.get(key) != method.row.get(key):
                row[key] = max(row[key], method.row[key]) if key in ("tried", "left_out") else None
        row.update({k: v for k, v in method.row.items() if row.get(k) is None and k not in METHOD})
    if any(row[key] != method.row[key] for method in group for key in ("window", "threshold")):
        row["settings"] = None
    runs = [run for method in group for run in method.runs]
    done = sum(run.done for run in runs)
    status = "done" if done == len(runs) else f"{done} of {len(runs)} done"
    row |= {"data": name, "seeds": len(runs), "status": status}
    row["settings"] = row["settings"] or ""
    row["chosen_on"] = "for each data set apart"
    return MethodRuns(row, runs)


class _Sorted:
    """Runs by backend and selector, setting and data set."""

    def __init__(self, choosing: Sequence[Run], shown: Sequence[Run]) -> None:
        every = list({run.path: run for run in (*choosing, *shown)}.values())
        words, data = frame.labels(every), frame.data_labels(every)
        # what tells a setting from all others, not from those alone that are shown
        self._rows = {r.path: frame.row(r, words[r.path], data[r.path]) for r in every}
        self.groups: Groups = {}
        where = {}
        for run in every:
            row = self._rows[run.path]
            settings = self.groups.setdefault((row["backend"], row["selector"]), {})
            where[run.path] = settings.setdefault(run.way, Setting({}, {}))
        for run in choosing:
            where[run.path].choosing.setdefault(self.data(run), []).append(run)
        for run in shown:
            where[run.path].shown.setdefault(self.data(run), []).append(run)
        self.shown = list(dict.fromkeys(self.data(run) for run in shown))

    def data(self, run: Run) -> str:
        """The name of a run's data set."""
        return str(self._rows[run.path]["data"])

    def on(self, data: str) -> list[tuple[tuple[Any, Any], dict[str, Setting]]]:
        """The groups that have something to show on a data set."""
        return [
            (key, settings)
            for key, settings in self.groups.items()
            if any(data in setting.shown for setting in settings.values())
        ]

    def method(self, setting: Setting, data: str, choice: dict[str, Any]) -> MethodRuns:
        """The runs of a setting on a data set, with its choice in the row."""
        runs = setting.shown[data]
        (method,) = frame.methods(runs)
        row = {key: self._rows[runs[0].path][key] for key in ("data", "settings")}
        return MethodRuns({**method.row, **row, **choice}, runs)

    def nothing(self, settings: Iterable[Setting], data: str, choice: dict[str, Any]) -> MethodRuns:
        """The row of a method of which no setting could be chosen."""
        first = next(setting.shown[data][0] for setting in settings if data in setting.shown)
        known = self._rows[first.path]
        row = dict.fromkeys(known) | {"seeds": 0, "status": "no choice", "settings": ""}
        row |= {key: known[key] for key in ("dataset", "data", "backend", "selector")}
        return MethodRuns({**row, **choice}, [])


def _labels(names: Sequence[str]) -> dict[str, str]:
    """The names in short, where they stay different: without the first word if it is the same for
    all, of a file or folder its name alone."""
    first = {name.partition(" ")[0] for name in names}
    if len(first) > 1:
        return {name: name for name in names}
    own = {name: name.partition(" ")[2] or name for name in names}
    short = {name: re.sub(r"\w+=\S*/(?=[^/\s]+)", "", words) for name, words in own.items()}
    return short if len(set(short.values())) == len(set(names)) else own


def _choose(
    runs: _Sorted, settings: Mapping[str, Setting], data: str, others: Sequence[str], words: str
) -> MethodRuns:
    """The best setting on the data sets ``others``, with its runs on ``data``."""
    candidates = [one for one in settings.values() if data in one.shown]
    tried = [one for one in candidates if all(name in one.choosing for name in others)]
    choice: dict[str, Any] = {
        "tried": len(tried),
        "equal": 1,
        "left_out": len(settings) - len(tried),
    }
    if len(tried) == 1:  # nothing was chosen, so no data chose it
        return runs.method(tried[0], data, {**choice, "chosen_on": ""})
    best, equal = best_of(tried, others)
    choice |= {"equal": equal, "chosen_on": words}
    return runs.method(best, data, choice) if best else runs.nothing(candidates, data, choice)


def best_of(
    settings: Sequence[Setting], names: Sequence[str], key: str | None = None
) -> tuple[Setting | None, int]:
    """The best setting on these data sets, and how many have its very score; None without any
    number on them.

    Of those with the fewest runs that lack an error the one with the least mean over data sets
    of the mean logarithm (of replicates: the median); over those data sets that all of them have
    a number on. ``key``: the error; None: the first main one that their runs have.
    """
    lost = [0] * len(settings)
    logs: list[dict[str, float]] = [{} for _ in settings]
    for name in names:
        runs = [setting.choosing[name] for setting in settings]
        error = key or _main_key([run for group in runs for run in group])
        most = max(len(group) for group in runs)
        for k, group in enumerate(runs):
            of_runs = _logs(group, error)
            lost[k] += most - len(of_runs)
            if of_runs:
                logs[k][name] = _middle(group, error)
    left = [k for k in range(len(settings)) if lost[k] == min(lost) and logs[k]]
    left = left or [k for k in range(len(settings)) if logs[k]]
    common = [name for name in names if all(name in logs[k] for k in left)]
    scores = {}
    for k in left:
        of_data = [logs[k][name] for name in common or logs[k]]
        scores[k] = sum(of_data) / len(of_data)
    if not scores:
        return None, 1
    least = min(scores.values())
    first = next(k for k in left if scores[k] == least)
    return settings[first], sum(score == least for score in scores.values())


def _main_key(runs: Sequence[Run]) -> str | None:
    """The first of ``best_settings.ERRORS`` that any of the runs has."""
    present = (
        key
        for key, _, _ in best_settings.ERRORS
        if any(_error(run, key) is not None for run in runs)
    )
    return next(present, None)


def _error(run: Run, key: str) -> float | None:
    value: Any = run.metrics.get(key) if run.done else None
    return float(value) if is_number(value) and math.isfinite(value) else None


def _middle(runs: Sequence[Run], key: str | None) -> float:
    """The mean logarithm over runs; with replicates the median over those that differ."""
    if any(map(number_of, runs)):
        return median(_logs(counted(runs), key) or _logs(runs, key))
    return fmean(_logs(runs, key))


def _logs(runs: Sequence[Run], key: str | None) -> list[float]:
    errors = [_error(run, key) for run in runs] if key else []
    return [math.log(max(error, LEAST)) for error in errors if error is not None]


def _split(
    runs: Sequence[Run], key: str, values: Sequence[str], words: str
) -> tuple[list[Run], list[Run]]:
    """The runs that choose and the others."""
    of_runs = [_value(run, key) for run in runs]
    if all(value is None for value in of_runs):
        raise ConfigError(f"--choose-on {words}: none of these runs has a {key}")
    for wanted in values:
        if not any(_same(value, wanted) for value in of_runs):
            known = ", ".join(dict.fromkeys(str(v) for v in of_runs if v is not None))
            raise ConfigError(f"--choose-on {words}: no run has {key}={wanted}; known: {known}")
    chooses = [any(_same(value, wanted) for wanted in values) for value in of_runs]
    choosing = [run for run, yes in zip(runs, chooses, strict=True) if yes]
    shown = [run for run, yes in zip(runs, chooses, strict=True) if not yes]
    if not shown:
        raise ConfigError(f"--choose-on {words}: all runs have it, none is left to be shown")
    return choosing, shown


def _value(run: Run, key: str) -> Any:
    """A run's seed, choice or setting; a bare name may also be one of its data set's."""
    if key == "seed":
        return run.record.get("seed")
    if key in run.record["choices"]:
        return run.record["choices"][key]
    for node in (run.config, run.config.get("dataset")):
        for part in key.split("."):
            node = node.get(part) if isinstance(node, dict) else None
        if node is not None:
            return node
    return None


def _same(value: Any, wanted: str) -> bool:
    try:
        return value is not None and float(value) == float(wanted)
    except (TypeError, ValueError):
        return str(value) == wanted
