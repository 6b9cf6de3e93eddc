"""How RBTM compares with its controls, in sentences computed from the numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rbtm_bench.report import better
from rbtm_bench.report.best_settings import NO_METHODS, main_error, winner
from rbtm_bench.report.better import DISTINCT, REPLICATES, SIGNIFICANT, Comparison
from rbtm_bench.report.frame import MethodRuns
from rbtm_bench.report.margin import margin_of
from rbtm_bench.report.render import is_numeric_cell, three_digits
from rbtm_bench.report.rotation import RBTM, is_previous

if TYPE_CHECKING:
    import pandas as pd

NO_CONTROL = (*RBTM, *NO_METHODS)
"""Selectors that rbtm is not held against: itself, what sees the truth, and its own gaps, which
have a test of their own (``report.rotation``)."""

Pairs = dict[tuple[Any, Any], Comparison]
"""Comparisons by the rows of both sides."""


def verdict(
    table: pd.DataFrame, methods: Sequence[MethodRuns] = (), say_tries: bool = True
) -> list[str]:
    """Sentences, computed from the numbers, on how rbtm compares with its controls.

    ``table`` has a row a method (medians over replicates, or seeds), ``methods`` their runs in
    that order; without them the rows are single runs. A line for every data set and backend that
    has rbtm and at least one control; "better" as ``report.better`` has it, adjusted for every
    setting of rbtm against every control, shown or not. Without ``say_tries`` somebody else says
    of how many settings each is the best.
    """
    pairs = _comparisons(table, methods)
    lines: list[str] = []
    for (data, backend), rows in table.groupby(["data", "backend"], sort=False):
        error = main_error(table[table.data == data])
        if error is None or backend == "none":
            continue
        key, unit, name = error
        known = rows.dropna(subset=[key]).astype({key: float})
        if known.empty:  # all of a backend's runs failed
            continue
        ours, controls = known[known.selector == "rbtm"], known[_are_controls(known)]
        best, rival = winner(ours, key), winner(controls, key)
        if best is None or rival is None:
            continue
        line = (
            f"{data}, {backend}: {name} of {label(best)} is {three_digits(best[key])} {unit}, "
            f"of the best control, {label(rival)}, {three_digits(rival[key])} {unit}: "
            f"{_words(best, rival, key, pairs)}"
        )
        line += "; its threshold never decided" if best.get("decided") == 0 else ""
        others = {"previous": known[known.selector == "previous"]}
        others = {} if rival.selector == "previous" else others
        others["no registration"] = table[(table.data == data) & (table.backend == "none")]
        for what, candidates in others.items():
            other = winner(candidates.dropna(subset=[key]), key)
            if other is not None:
                line += f"; {what} {three_digits(other[key])} {unit}, "
                line += _words(best, other, key, pairs)
        tries = rows[~rows.selector.isin(NO_METHODS)].groupby("selector", sort=False).size()
        if say_tries and tries.max() > 1:
            line += ". Best of " + ", ".join(f"{n} x {s}" for s, n in tries.items())
            line += " settings, chosen on this very data"
        lines.append(line + ".")
    return [*lines, *rule(list(pairs.values()))]


def _comparisons(table: pd.DataFrame, methods: Sequence[MethodRuns]) -> Pairs:
    """Every setting of rbtm against every control of its backend and no registration, adjusted
    for all of them."""
    pairs: Pairs = {}
    runs = dict(zip(table.index, methods, strict=False))
    for _, on_data in table.groupby("data", sort=False):
        error = main_error(on_data)
        if error is None or not runs:
            continue
        margin = margin_of([runs[i] for i in on_data.index], error[0])
        nothing = on_data[on_data.backend == "none"].index
        for backend, rows in on_data.groupby("backend", sort=False):
            if backend == "none":
                continue
            ours = rows[rows.selector == "rbtm"].index
            others = [*rows[_are_controls(rows)].index, *nothing]
            for i, j in ((i, j) for i in ours for j in others):
                comparison = better.compare(runs[i], runs[j], error[0], margin)
                if comparison is not None:
                    pairs[i, j] = comparison
    return dict(zip(pairs, better.adjusted(list(pairs.values())), strict=True))


def _are_controls(rows: pd.DataFrame) -> list[bool]:
    """Which rows rbtm is held against: no keyframe rule that is ``previous`` under another name."""
    return [
        row["selector"] not in NO_CONTROL and not is_previous(row)
        for row in rows.to_dict("records")
    ]


def _words(ours: pd.Series[Any], other: pd.Series[Any], key: str, pairs: Pairs) -> str:
    comparison = pairs.get((ours.name, other.name))
    if comparison is None:
        seeds = [row["seeds"] for row in (ours, other) if is_numeric_cell(row.get("seeds"))]
        runs = int(min(seeds, default=1))
        comparison = better.of_runs(float(ours[key]), float(other[key]), runs)
    if comparison.holds == "better" and ours.get("decided") == 0:  # it is a control itself
        return "rbtm is not called better: its threshold never decided (column decided)"
    return comparison.words("rbtm")


def rule(comparisons: Sequence[Comparison]) -> list[str]:
    """What "better" took, where replicates were compared."""
    over = [one for one in comparisons if one.unit == REPLICATES]
    if not over:
        return []
    margins = dict.fromkeys(one.margin for one in over)
    words = " or ".join(f"{margin.factor:.3g} ({margin.source})" for margin in margins)
    return [
        f"better or worse: p < {SIGNIFICANT} after Holm over {over[0].tests} comparisons, a ratio "
        f"beyond {words}, and {DISTINCT} distinct trajectories on either side; "
        "said of this log under these perturbations, not of others"
    ]


def label(row: Mapping[str, Any] | pd.Series[Any]) -> str:
    """A method's selector and its settings."""
    details = [f"{k} {row[k]:g}" for k in ("window", "threshold") if is_numeric_cell(row.get(k))]
    extra = row.get("settings")
    details += [str(extra)] if extra else []
    return f"{row['selector']} ({', '.join(details)})" if details else str(row["selector"])
