"""The table with intervals, and how tables with intervals are shown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rbtm_bench.core.columns import REFERENCES
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.report import best_settings, intervals, render
from rbtm_bench.report.frame import METHOD, MethodRuns
from rbtm_bench.report.intervals import Statistic
from rbtm_bench.report.replicates import OF_MAIN
from rbtm_bench.report.units import Units, grouped, methods_to_compare, shared
from rbtm_bench.runs.stored import Run, is_number

if TYPE_CHECKING:
    import pandas as pd

BESIDE = {
    **{key: names[:1] for key, names in best_settings.SECOND.items()},
    "relations_translation_mean_m": (
        "relations_local_translation_mean_m",
        "relations_long_translation_mean_m",
    ),
}
"""What stands beside the main error unless metrics are named."""


def interval_table(
    runs: Sequence[Run],
    metrics: Sequence[str] = (),
    statistic: Statistic = "median",
    pool: bool = False,
    methods: Sequence[MethodRuns] | None = None,
) -> pd.DataFrame:
    """A row a method: for each metric its value, KEY_low, KEY_high and KEY_n, the units.

    The value is the median (or mean) over data sets, on one over its replicates. KEY_clusters is
    the mean of the relation errors of one log with an interval over their clusters: within a run,
    not between runs. ``rank`` is the mean rank by the first metric among the methods
    of a data set and backend, over the data sets that all of them have; none by a metric whose
    meaning hangs on its references, which become columns for ``render.render``.
    ``methods``: these instead of all (``held_out.leave_one_out``).
    """
    import pandas as pd

    rows: list[dict[str, Any]] = []
    for group in grouped(methods or methods_to_compare(runs, pool), ("data", "backend")):
        keys = metrics or keys_of(group, beside=True)
        of_group = [Units(method) for method in group]
        ranked = keys[:1] if keys and not references_of(runs, keys[0]) else []
        ranks = _ranks(of_group, ranked[0]) if ranked else [None] * len(of_group)
        for units, rank in zip(of_group, ranks, strict=True):
            row = {key: units.row[key] for key in (*METHOD, "seeds", "status")}
            row |= choice_of(units.row)
            for key in keys:
                over = units.estimate(key, statistic)
                row[key] = over.value if over else None
                row[f"{key}_low"] = over.low if over else None
                row[f"{key}_high"] = over.high if over else None
                row[f"{key}_n"] = over.n if over else 0
                row |= _clusters(units, key)
                row |= {f"{key}_{e}": v for e in OF_MAIN if (v := units.row.get(f"{key}_{e}"))}
                row |= {name: units.row.get(name) for name in references_of(runs, key)}
            rows.append({**row, "rank": rank})
    table = pd.DataFrame(rows)
    table = table[[*(c for c in table if c != "rank"), "rank"]]
    counts = {c: int for c in table if str(c).endswith("_n")}
    return table.fillna(dict.fromkeys(counts, 0)).astype({**counts, "rank": float})


def _clusters(units: Units, key: str) -> dict[str, Any]:
    """The columns of a number that is a mean over the relations of one log."""
    within = units.clusters(key)
    if within is None:
        return {}
    name = f"{key}_clusters"
    ends = {f"{name}_low": within.low, f"{name}_high": within.high, f"{name}_n": within.n}
    return {name: within.value, **ends}


def choice_of(row: dict[str, Any]) -> dict[str, Any]:
    """What the row of a setting chosen on other data says of its choice."""
    return {key: row[key] for key in ("tried", "chosen_on") if key in row}


def _ranks(methods: Sequence[Units], key: str) -> list[float | None]:
    """Mean ranks over the data sets that all methods have."""
    values = [units.by_data_set(key) for units in methods]
    common = shared(methods, key)
    ranks = intervals.mean_ranks(np.array([[v[name] for v in values] for name in common]))
    if ranks is None or len(methods) < 2:
        return [None] * len(methods)
    return [float(rank) for rank in ranks]


def references_of(runs: Sequence[Run], key: str) -> list[str]:
    """The keys of the same number of other trajectories: of the truth, of no motion."""
    names = [key + end for end in REFERENCES]
    return [name for name in names if any(name in run.metrics for run in runs)]


def keys_of(group: Sequence[MethodRuns], beside: bool) -> list[str]:
    """The main error of the methods and, if wanted, what stands beside it."""
    import pandas as pd

    rows = pd.DataFrame([method.row for method in group])
    main = best_settings.main_error(rows)
    if main is None:
        return []
    more = BESIDE[main[0]] if beside else ()
    return [main[0], *(key for key in more if key in rows and rows[key].notna().any())]


def named_metrics(runs: Sequence[Run], names: str | None) -> list[str]:
    """The metrics of a comma list. Raises ``ConfigError`` for one that no run has a number of."""
    wanted = [name.strip() for name in (names or "").split(",") if name.strip()]
    known = dict.fromkeys(k for run in runs for k, v in run.metrics.items() if is_number(v))
    for name in wanted:
        if name not in known:
            words = f"--metric {name}: none of these runs has a number of that name."
            raise ConfigError(f"{words} Known: {', '.join(known) or 'none'}")
    return wanted


def folded(table: pd.DataFrame) -> pd.DataFrame:
    """The table for readers: "0.55 [0.3, 0.9] (62)" in one column instead of four."""
    readable = table.copy()
    for key in [c for c in table if f"{c}_low" in table]:
        parts = [f"{key}_low", f"{key}_high", f"{key}_n"]
        cells = zip(table[key], *(table[part] for part in parts), strict=True)
        readable[key] = [_cell(*cell) for cell in cells]
        readable = readable.drop(columns=parts)
    return readable


def _cell(value: float | None, low: float | None, high: float | None, n: int) -> str:
    if value is None or np.isnan(value):
        return ""
    words = render.three_digits(value)
    if low is not None and high is not None and not np.isnan(low):
        words += f" [{render.three_digits(low)}, {render.three_digits(high)}]"
    return f"{words} ({n})"


def interval_notes(table: pd.DataFrame, statistic: Statistic) -> list[str]:
    """The notes beside a table of intervals."""
    lines = [
        f"{statistic} over data sets (seeds), on one log over its replicates [bootstrap 95% "
        "interval] (units)"
    ]
    if any(str(c).endswith("_clusters") for c in table):
        lines.append(
            "clusters: mean of one run's relation errors [over place-time clusters] (clusters); "
            "says nothing of another run"
        )
    counts = {int(n) for c in table if str(c).endswith("_n") for n in table[c]} - {0}
    few = sorted(n for n in counts if intervals.FEWEST_UNITS <= n < intervals.INDEPENDENT)
    if few:
        shares = ", ".join(f"{100 * (1 - 0.5 ** (n - 1)):.0f}% with {n}" for n in few)
        lines.append(f"of few units an interval covers less than it says: at most {shares}")
    if min(counts, default=intervals.FEWEST_UNITS) < intervals.FEWEST_UNITS:
        one = "a log is one, and so are seeds that change nothing"
        lines.append(f"no interval of fewer than {intervals.FEWEST_UNITS} units ({one})")
    if table["rank"].notna().any():
        lines.append("rank: mean over the data sets that all methods of a backend have; 1 is least")
    return lines
