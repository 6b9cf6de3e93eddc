"""How RBTM compares with its controls, in sentences computed from the numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rbtm_bench.report.best_settings import main_error, winner
from rbtm_bench.report.render import is_numeric_cell, three_digits

if TYPE_CHECKING:
    import pandas as pd

NO_CONTROL = ("rbtm", "rbtm_verified", "oracle")
"""Selectors that rbtm is not held against: itself, and what sees the truth."""


def verdict(table: pd.DataFrame, say_tries: bool = True) -> list[str]:
    """Sentences, computed from the numbers, on how rbtm compares with its controls.

    ``table`` has a row a method (medians over seeds). A line for every data set and backend that
    has rbtm and at least one control. Not a test of significance: medians are compared. Without
    ``say_tries`` somebody else says of how many settings each is the best.
    """
    lines: list[str] = []
    for (data, backend), methods in table.groupby(["data", "backend"], sort=False):
        on_data = table[table.data == data]
        error = main_error(on_data)
        if error is None:
            continue
        key, unit, name = error
        rows = methods.dropna(subset=[key]).astype({key: float})
        ours, controls = rows[rows.selector == "rbtm"], rows[~rows.selector.isin(NO_CONTROL)]
        best, rival = winner(ours, key), winner(controls, key)
        if best is None or rival is None or backend == "none":
            continue
        line = (
            f"{data}, {backend}: {name} of {_label(best)} is {three_digits(best[key])} {unit}, "
            f"of the best control, {_label(rival)}, {three_digits(rival[key])} {unit}: "
            f"{_relation(float(best[key]), float(rival[key]))}"
        )
        previous = rows[rows.selector == "previous"]
        if not previous.empty and rival.selector != "previous":
            value = float(previous[key].min())
            line += f"; previous {three_digits(value)} {unit}, {_relation(float(best[key]), value)}"
        line += _without_registration(table, str(data), key, unit, float(best[key]))
        tries = methods.groupby("selector", sort=False).size()
        if say_tries and tries.max() > 1:
            line += ". Best of " + ", ".join(f"{n} x {s}" for s, n in tries.items())
            line += " settings, chosen on this very data"
        lines.append(line + ".")
    return lines


def _without_registration(table: pd.DataFrame, data: str, key: str, unit: str, ours: float) -> str:
    """The baseline that every registration has to beat, where the table has it."""
    rows = table[(table.data == data) & (table.backend == "none")][key].dropna()
    if rows.empty:
        return ""
    value = float(rows.min())
    return f"; no registration {three_digits(value)} {unit}, {_relation(ours, value)}"


def _label(row: pd.Series[Any]) -> str:
    details = [f"{k} {row[k]:g}" for k in ("window", "threshold") if is_numeric_cell(row.get(k))]
    extra = row.get("settings")
    details += [str(extra)] if extra else []
    return f"{row['selector']} ({', '.join(details)})" if details else str(row["selector"])


def _relation(ours: float, other: float) -> str:
    if ours == other:
        return "rbtm is equal"
    if min(ours, other) <= 0:
        return "rbtm is better" if ours < other else "rbtm is worse"
    ratio = max(ours, other) / min(ours, other)
    if ratio < 1.05:
        return "rbtm is as good, within 5%"
    return f"rbtm is {ratio:.3g} times {'better' if ours < other else 'worse'}"
