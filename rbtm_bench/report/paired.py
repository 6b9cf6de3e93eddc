"""The table of paired differences from a reference method."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from rbtm_bench.core.columns import less_is_better
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.wording import shown
from rbtm_bench.report import best_settings, intervals
from rbtm_bench.report.better import DISTINCT, REPLICATES, SIGNIFICANT
from rbtm_bench.report.frame import METHOD, MethodRuns
from rbtm_bench.report.margin import Margin, margin_of
from rbtm_bench.report.units import CLUSTERS, Units, grouped, methods_to_compare
from rbtm_bench.report.with_intervals import choice_of, keys_of, references_of
from rbtm_bench.runs.declared import GROUPS
from rbtm_bench.runs.stored import Run

if TYPE_CHECKING:
    import pandas as pd


def against(
    runs: Sequence[Run],
    reference: str,
    metrics: Sequence[str] = (),
    pool: bool = False,
    methods: Sequence[MethodRuns] | None = None,
) -> pd.DataFrame:
    """A row a method and metric: how it differs from the reference on the same data.

    ``reference`` names a selector, a backend, or both, with as many settings as make it one
    method ("previous", "selector=keyframe distance=0.3", "backend=none"), or a member of another
    group ("guess=odometry"). The backend and the selector that it leaves open are the same on
    both sides. ``p_holm`` is adjusted for all tests of the table; ``holds`` says
    "better" or "worse" (for what is no error, "lower" or "higher") only where it is below 0.05,
    the interval excludes 0, and no run of the side that would win has failed. ``methods``: these
    instead of all (``held_out.leave_one_out``).

    Raises ``ConfigError`` for a reference that is no method of these runs, or several, and for a
    metric of which less is not better without the truth beside it.
    """
    for key in metrics:
        if references_of(runs, key):
            raise ConfigError(
                f"--metric {key}: no comparison by it, no motion may beat the truth; --intervals "
                "shows it beside both"
            )
    methods = methods or methods_to_compare(runs, pool)
    words = _words(reference, methods)
    open_ = [name for name in ("backend", "selector") if name not in words]
    if not any(_is(method, words) for method in methods):
        raise ConfigError(f"--against {reference}: none of these methods is that")
    rows: list[dict[str, Any]] = []
    for group in grouped(methods, ("data", *open_)):
        base = [method for method in group if _is(method, words)]
        if len(base) > 1:
            _refuse_several(reference, base)
        base_units = Units(base[0]) if base else None
        name = _label(base[0].row, words) if base else None
        keys = metrics or keys_of(group, beside=False)
        rivals = [Units(method) for method in group if method not in base]
        margins = {key: margin_of(group, key) for key in keys}
        rows += [
            _row(rival, base_units, key, name, margins[key]) for rival in rivals for key in keys
        ]
    if all(row["difference"] is None for row in rows):
        raise ConfigError(f"--against {reference}: no other method has a number on the same data")
    tests = sum(row["p"] is not None for row in rows)
    for row, p in zip(rows, intervals.holm([row["p"] for row in rows]), strict=True):
        row["p_holm"] = p
        by_replicates = row.pop("comparison")
        if by_replicates is not None and less_is_better(row["metric"]):
            row["holds"] = replace(by_replicates, p_holm=p, tests=tests).holds
        else:
            row["holds"] = _holds(row)
    return _in_order(rows)


def _in_order(rows: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """The rows as a table, its columns in the order in which they are read."""
    import pandas as pd

    columns = [*METHOD, "status", *choice_of(rows[0]), "reference", "reference_status", "metric"]
    columns += ["error", "reference_error", "difference", "difference_low", "difference_high"]
    ratios = ["ratio", "ratio_low", "ratio_high", "ratio_n", "margin"]
    ratios = ratios if any(row["unit"] == REPLICATES for row in rows) else []
    columns += ["difference_n", "unit", *ratios, "p", "p_holm", "holds"]
    starts = ("p", "difference", "error", "reference_error", "ratio", "margin")
    numbers = [c for c in columns if c.startswith(starts)]
    kinds = dict.fromkeys(numbers, "float64") | {"difference_n": "int64"}
    kinds |= {name: "int64" for name in ratios if name.endswith("_n")}
    return pd.DataFrame(rows)[columns].astype(kinds)


def _words(reference: str, methods: Sequence[MethodRuns]) -> dict[str, str]:
    """The reference as key -> value; a bare word is a selector or else a backend."""
    names = {
        key: list(dict.fromkeys(str(m.row[key]) for m in methods if m.row[key]))
        for key in ("selector", "backend")
    }
    words: dict[str, str] = {}
    for word in re.split(r"[\s,]+", reference.strip()):
        key, equals, value = word.partition("=")
        if not equals:
            value = key
            key = "selector" if value not in names["backend"] else "backend"
        key = key.removeprefix("selector.")
        if value not in names.get(key, [value]):
            known = f"known {key}s: {', '.join(names[key])}"
            raise ConfigError(f"--against {reference}: no {key} {value} in these runs; {known}")
        words[key] = value
    if not words.keys() <= set(GROUPS) and not words.keys() & {"selector", "backend"}:
        raise ConfigError(f"--against {reference}: expected a selector or a backend, and more")
    return words


def _is(method: MethodRuns, words: dict[str, str]) -> bool:
    """Whether a method has all that the words say."""
    return all(_same(_value(method, key), value) for key, value in words.items())


def _value(method: MethodRuns, key: str) -> Any:
    """A column of the method's row, a setting of its selector, or one by its whole name."""
    if key in ("selector", "backend", "window", "threshold") or not method.runs:
        return method.row.get(key)
    run = method.runs[0]
    settings = {**run.choices, **run.identity.what, **run.identity.settings("selector")}
    return settings.get(key)


def _same(value: Any, word: str) -> bool:
    try:
        return value is not None and float(value) == float(word)
    except (TypeError, ValueError):
        return shown(value) == word


def _refuse_several(reference: str, base: Sequence[MethodRuns]) -> None:
    labels = [_label(method.row, ("backend", "selector")) for method in base]
    more = len(labels) - best_settings.MOST_LISTED
    listed = "; ".join(labels[: best_settings.MOST_LISTED]) + (f"; {more} more" if more > 0 else "")
    where = f"on {base[0].row['data']}"
    raise ConfigError(f"--against {reference}: several methods {where}, name one: {listed}")


def _label(row: dict[str, Any], named: Collection[str]) -> str:
    """A method as ``--against`` takes it: "rbtm window=8 threshold=0.5"; of backend and selector
    only what was named, the other is the same on both sides."""
    parts = [str(row[key]) for key in ("backend", "selector") if key in named and row[key]]
    if "selector" in named:
        values = {key: row[key] for key in ("window", "threshold") if row[key] is not None}
        parts += [f"{key}={value:g}" for key, value in values.items()]
        parts += [row["settings"]] if row["settings"] else []
    if isinstance(named, dict) and not {"backend", "selector"} & named.keys():
        parts = [f"{key}={value}" for key, value in named.items()]
    return " ".join(parts)


def _row(
    method: Units, base: Units | None, key: str, reference: str | None, margin: Margin
) -> dict[str, Any]:
    """The method beside the reference, if the data have one, without what depends on other rows."""
    row: dict[str, Any] = {name: method.row[name] for name in (*METHOD, "status")}
    status = base.row["status"] if base else None
    row |= choice_of(method.row)
    row |= {"reference": reference, "reference_status": status, "metric": key}
    difference = method.minus(base, key, margin) if base else None
    by_replicates = difference.comparison if difference else None
    ratio = by_replicates.ratio if by_replicates else None
    row |= {
        "error": difference.error if difference else None,
        "reference_error": difference.reference if difference else None,
        "difference": difference.interval.value if difference else None,
        "difference_low": difference.interval.low if difference else None,
        "difference_high": difference.interval.high if difference else None,
        "difference_n": difference.interval.n if difference else 0,
        "unit": difference.unit if difference else None,
        "p": difference.p if difference else None,
        "ratio": ratio.value if ratio else None,
        "ratio_low": ratio.low if ratio else None,
        "ratio_high": ratio.high if ratio else None,
        "ratio_n": ratio.n if ratio else 0,
        "margin": margin.factor if ratio else None,
        "comparison": by_replicates,
    }
    return row


def _holds(row: dict[str, Any]) -> str:
    """Which way the difference goes, if any."""
    low, high, p = row["difference_low"], row["difference_high"], row["p_holm"]
    if p is None or low is None or p >= SIGNIFICANT or low <= 0 <= high:
        return ""
    less = bool(high < 0)
    if row["status" if less else "reference_status"] != "done":
        return ""  # the runs that failed are not in the comparison
    if less_is_better(row["metric"]):
        return "better" if less else "worse"
    return "lower" if less else "higher"


def difference_notes(table: pd.DataFrame) -> list[str]:
    """The notes beside a table of differences."""
    lines = [
        "difference: method - reference, paired [bootstrap 95% interval] (units): median over "
        "data sets, or mean over the place-time clusters of one log's relations"
    ]
    tests = int(table["p"].notna().sum())
    if tests:
        number = "1 test" if tests == 1 else f"{tests} tests"
        lines.append(
            f"p: Wilcoxon signed-rank, of replicates sign flips of log ratios; p_holm: adjusted "
            f"for {number}; holds: p_holm < {SIGNIFICANT} and the interval excludes 0"
        )
    if (table["unit"] == REPLICATES).any():
        lines.append(
            f"of replicates also: the ratio of medians lies beyond the margin, {DISTINCT} distinct "
            "trajectories on either side; on this log, under these perturbations"
        )
    few = (table["difference_n"] < intervals.INDEPENDENT) & (table["unit"] != REPLICATES)
    few |= table["unit"] == CLUSTERS
    if (few & table["difference"].notna()).any():
        lines.append(
            f"no test, and nothing called better, on fewer than {intervals.INDEPENDENT} "
            "independent data sets (a log is one)"
        )
    if table["difference"].isna().any():
        lines.append("no difference where the reference, or a number of it, is missing")
    failed = (table["status"] != "done") | (table["reference_status"] != "done")
    if (failed & table["p"].notna()).any():
        lines.append("a method of which a run failed is not called better by the others")
    return lines
