"""Runs as the rows of a table: labelled by what differs in it, medians over seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rbtm_bench.core.columns import COLUMNS, MAIN
from rbtm_bench.core.errors import ConfigError, one_line
from rbtm_bench.report.replicates import counted, number_of, spread_columns
from rbtm_bench.runs.identity import differing
from rbtm_bench.runs.stored import Run, is_number

if TYPE_CHECKING:
    import pandas as pd

METHOD = ("data", "backend", "selector", "window", "threshold", "settings")
"""The columns that say what was compared on what."""

FIRST = (
    *("run", "status", "dataset", *METHOD, "control", "seed", "replicate", "scans"),
    *(column.name for column in COLUMNS if column.table and not column.cost),
    "seconds",
    *(column.name for column in COLUMNS if column.table and column.cost),
)
"""The columns of a table, in order; a run's further metrics follow, then the reason of failure."""


def row(run: Run, label: str = "", data: str = "") -> dict[str, Any]:
    """A run as one row of a table; what does not exist is None.

    ``label`` tells it from the other rows (``labels``), ``data`` its data from others
    (``data_labels``).
    """
    selector, choices = run.section("selector"), run.choices
    values: dict[str, Any] = {
        "run": run.path.resolve().name,
        "status": run.record.get("status"),
        "dataset": choices.get("dataset"),
        "data": " ".join(filter(None, [choices.get("dataset"), data])) or None,
        "backend": choices.get("backend"),
        "selector": choices.get("selector"),
        "window": selector.get("window"),
        "threshold": selector.get("threshold"),
        "settings": label,
        "control": (run.record.get("control") or {}).get("how"),
        "seed": run.record.get("seed"),
        "replicate": number_of(run),
        "scans": run.record.get("scans"),
        "seconds": run.record.get("seconds"),
        **(run.metrics if run.done else {}),
    }
    ordered = {key: values.get(key) for key in FIRST}
    ordered.update({key: value for key, value in values.items() if key not in ordered})
    ordered["reason"] = run.record.get("reason")
    return ordered


LABELLED = (
    *("similarity", "guess", "search", "check", "recovery", "target", "loops"),
    *("metrics", "backend", ""),
)
"""The groups whose differences a label names, beside the selector's; "": settings outside all."""
COLUMNED = ("selector.window", "selector.threshold")
"""Settings that have columns of their own."""
FOLLOWING = ("dataset.relations", "dataset.poses")
"""What belongs to a data set's path says nothing more than the path."""


def labels(runs: Sequence[Run]) -> dict[Path, str]:
    """For every run what tells it from the others of this table on its data set, by its backend
    and selector, and has no column of its own: "distance=0.3 guess=odometry backend.kernel=huber".

    The selector's own settings are bare; nothing that is the same in every row is named.
    """
    words: dict[Path, list[str]] = {run.path: [] for run in runs}
    for group in _grouped(runs, "dataset", "selector"):
        for run, label in zip(group, _differing(group, ["selector"], COLUMNED), strict=True):
            words[run.path] += [f"{k.removeprefix('selector.')}={_plain(v)}" for k, v in label]
        sources = {run.path: source_words(run) for run in group if run.source or _gaps(run)}
        if len(set(sources.values())) > 1:
            for path, source in sources.items():
                words[path].append(f"gaps of {source}")
    for group in _grouped(runs, "dataset", "backend", "selector"):
        for run, label in zip(group, _differing(group, LABELLED), strict=True):
            words[run.path] += [f"{k}={_plain(v)}" for k, v in label]
    return {path: " ".join(parts) for path, parts in words.items()}


def data_labels(runs: Sequence[Run]) -> dict[Path, str]:
    """For every run the settings of its data set that tell it from others: "path=aces.clf.gz".

    Runs on other data are not to be compared as if they were on the same.
    """
    words: dict[Path, str] = {}
    for group in _grouped(runs, "dataset"):
        has_path = any("path" in run.section("dataset") for run in group)
        labelled = _differing(group, ["dataset"], FOLLOWING if has_path else ())
        for run, label in zip(group, labelled, strict=True):
            parts = [f"{k.removeprefix('dataset.')}={_plain(v)}" for k, v in label]
            words[run.path] = " ".join(parts)
    return words


def source_words(run: Run) -> str:
    """The method whose gaps a run drew: "rbtm window=64 threshold=0.5", or the folder's name."""
    if run.source is None:
        return Path(str(_gaps(run))).name
    selector = run.source.section("selector")
    values = [f"{key}={selector[key]:g}" for key in ("window", "threshold") if key in selector]
    return " ".join([str(run.source.choices.get("selector")), *values])


def _gaps(run: Run) -> Any:
    return run.section("selector").get("gaps_from")


def _grouped(runs: Sequence[Run], *groups: str) -> list[list[Run]]:
    """The runs that agree in the choices of these groups, together."""
    together: dict[tuple[str | None, ...], list[Run]] = {}
    for run in runs:
        together.setdefault(tuple(run.choices.get(g) for g in groups), []).append(run)
    return list(together.values())


def _differing(
    runs: Sequence[Run], groups: Sequence[str], skip: Sequence[str] = ()
) -> list[list[tuple[str, Any]]]:
    labelled = differing([run.identity for run in runs], groups, skip)
    return [list(label.items()) for label in labelled]


def _plain(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def frame(runs: Sequence[Run]) -> pd.DataFrame:
    """One row a run."""
    import pandas as pd

    words, data = labels(runs), data_labels(runs)
    return _last(pd.DataFrame([row(run, words[run.path], data[run.path]) for run in runs]))


def filtered(table: pd.DataFrame, expression: str) -> pd.DataFrame:
    """The rows that pandas' query keeps. Raises ``ConfigError`` if it cannot be answered, or keeps
    none."""
    try:
        kept = table.query(expression, engine="python")
    except Exception as error:  # pandas raises whatever the expression does
        raise ConfigError(f"--filter {expression}: {one_line(error)}") from None
    if kept.empty:
        raise ConfigError(f"--filter {expression}: no row is left")
    return kept


def _last(table: pd.DataFrame) -> pd.DataFrame:
    """The table with the reason of failure after all metrics, whichever run came first."""
    if "reason" not in table:
        return table
    return table[[*(c for c in table if c != "reason"), "reason"]]


@dataclass(frozen=True, eq=False)
class MethodRuns:
    """Runs that differ only in their seed, and ``row``: the medians of their numbers, and in
    ``seeds`` how many they are. Failed ones have no numbers and show in ``status``. Where there
    are replicates, the medians are over the distinct ones (``replicates.counted``; ``replicates``
    says how many), with KEY_q1, KEY_q3, KEY_worst and KEY_unperturbed behind a main error."""

    row: dict[str, Any]
    runs: list[Run]


def methods(runs: Sequence[Run]) -> list[MethodRuns]:
    """The runs by method; those of a data set and backend follow one another."""
    words, data = labels(runs), data_labels(runs)
    groups: dict[str, list[Run]] = {}
    for run in runs:
        groups.setdefault(run.method, []).append(run)
    unordered = [
        MethodRuns(_row_of({r: row(r, words[r.path], data[r.path]) for r in group}), group)
        for group in groups.values()
    ]
    return by_data_and_backend(unordered)


def by_data_and_backend(methods: Sequence[MethodRuns]) -> list[MethodRuns]:
    """Data set by data set, the methods of a backend together."""
    order: dict[tuple[Any, Any], int] = {}
    for method in methods:
        order.setdefault((method.row["data"], method.row["backend"]), len(order))
    return sorted(methods, key=lambda method: order[(method.row["data"], method.row["backend"])])


def over_seeds(runs: Sequence[Run]) -> pd.DataFrame:
    """One row a method, as ``MethodRuns`` says."""
    return table_of(methods(runs))


def table_of(methods: Sequence[MethodRuns]) -> pd.DataFrame:
    """Their rows."""
    import pandas as pd

    return _last(pd.DataFrame([method.row for method in methods]))


def _row_of(rows: dict[Run, dict[str, Any]]) -> dict[str, Any]:
    """The row of a method from those of its runs."""
    kept = counted(list(rows))
    medians = _medians(list(rows.values()), [rows[run] for run in kept])
    spreads = spread_columns(list(rows), [column.name for column in MAIN])
    medians["replicates"] = sum(number_of(run) > 0 for run in kept) or None
    out: dict[str, Any] = {}
    for key, value in medians.items():
        out |= {key: value, **spreads.get(key, {})}
    return out


def _medians(every: list[dict[str, Any]], counted: list[dict[str, Any]]) -> dict[str, Any]:
    """The medians of the runs that count; seeds and status of every run."""
    out: dict[str, Any] = {}
    for key in dict.fromkeys(key for row in every for key in row):
        values: list[Any] = [row[key] for row in counted if not _is_missing(row.get(key))]
        if key == "replicate":
            out["replicates"] = None
        elif key == "seed":
            out["seeds"] = len({row.get(key) for row in every})
        elif key in ("run", "settings"):
            out[key] = every[0][key]
        elif key == "status":
            done = sum(row.get(key) == "done" for row in every)
            out[key] = "done" if done == len(every) else f"{done} of {len(every)} done"
        elif not values:
            out[key] = None
        else:
            out[key] = float(np.median(values)) if all(map(is_number, values)) else values[0]
    return out


def _is_missing(value: Any) -> bool:
    return value is None or value != value
