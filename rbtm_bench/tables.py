"""Tables of runs as text, CSV, Markdown, LaTeX, HTML and JSON, and the verdict in words."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

from rbtm_bench.errors import ConfigError

if TYPE_CHECKING:
    import pandas as pd

FORMATS = ("text", "csv", "md", "latex", "html", "json")

ERRORS = (
    ("relations_translation_mean_m", "m", "mean relation error"),
    ("final_translation_error_mm", "mm", "final position error"),
    ("ape_rmse_m", "m", "APE RMSE"),
)
"""What methods are compared by: the first of these that the runs on a data set have."""

SHORT = (
    "data",
    "backend",
    "selector",
    "window",
    "threshold",
    "settings",
    "seeds",
    "status",
    "coverage",
    "final_translation_error_mm",
    "final_along_mm",
    "final_cross_mm",
    "final_rotation_error_deg",
    "ape_rmse_m",
    "relations_translation_mean_m",
    "relations_translation_std_m",
    "relations_rotation_mean_deg",
    "relations_local_translation_mean_m",
    "relations_long_translation_mean_m",
    "registrations",
    "rejected",
    "fallbacks",
    "mean_gap",
    "ms_per_scan",
)
"""The columns of the table at the end of ``compare``."""

ALWAYS = ("backend", "selector")


def render(table: pd.DataFrame, fmt: str) -> str:
    """The table in one of ``FORMATS``. Text, Markdown, LaTeX and HTML leave out columns that are
    empty in every row and round to 4 digits; CSV and JSON keep everything."""
    if fmt == "csv":
        return table.to_csv(index=False).rstrip("\n")
    if fmt == "json":
        rows = table.astype(object).to_dict(orient="records")
        return json.dumps(
            [{k: None if _is_empty(v) else v for k, v in row.items()} for row in rows], indent=1
        )
    shown = table[[c for c in table if not all(_is_empty(v) for v in table[c])]]
    words = shown.map(_word)
    numeric = {c for c in shown if all(_is_number(v) or _is_empty(v) for v in shown[c])}
    if fmt == "html":
        return words.to_html(index=False, border=0, na_rep="", justify="left")
    if fmt == "latex":
        style = "".join("r" if c in numeric else "l" for c in shown)
        return str(
            words.style.hide(axis="index")
            .format(escape="latex")
            .format_index(escape="latex", axis=1)
            .to_latex(column_format=style, hrules=True)
        ).rstrip("\n")
    from tabulate import tabulate

    align = ["right" if c in numeric else "left" for c in shown]
    headers = list(shown) if fmt == "md" else [_stacked(str(c)) for c in shown]
    kind = "pipe" if fmt == "md" else "simple"
    if fmt == "md":
        words = words.map(lambda word: word.replace("|", "\\|"))
    return tabulate(
        words.to_numpy().tolist(), headers, tablefmt=kind, colalign=align, disable_numparse=True
    )


def existing_columns(table: pd.DataFrame, names: str) -> list[str]:
    """The columns of a comma list. Raises ``ConfigError`` for one that is not there."""
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    for name in wanted:
        if name not in table:
            raise ConfigError(f"--columns {name}: no such column. Known: {', '.join(table)}")
    return wanted


def screen(table: pd.DataFrame) -> tuple[pd.DataFrame, str]:
    """The columns that fit a screen, and in words those that are the same in every row."""
    shown = table[[c for c in SHORT if c in table]]
    if len(table) < 2:
        return shown, ""
    same = [c for c in shown if c not in ALWAYS and len({_word(v) for v in shown[c]}) == 1]
    words = [f"{c} {_word(shown[c].iloc[0])}" for c in same if _word(shown[c].iloc[0])]
    return shown.drop(columns=same), ", ".join(words)


def verdict(table: pd.DataFrame) -> list[str]:
    """Sentences, computed from the numbers, on how rbtm compares with its controls.

    ``table`` has a row a method (medians over seeds). A line for every data set and backend that
    has rbtm and at least one control. Not a test of significance: medians are compared.
    """
    lines: list[str] = []
    for (data, backend), methods in table.groupby(["data", "backend"], sort=False):
        here = table[table.data == data]
        usable = [c for c in ERRORS if c[0] in table and here[c[0]].notna().any()]
        if not usable:
            continue
        key, unit, name = usable[0]
        rows = methods.dropna(subset=[key]).astype({key: float})
        ours, controls = rows[rows.selector == "rbtm"], rows[rows.selector != "rbtm"]
        if ours.empty or controls.empty or backend == "none":
            continue
        best, rival = ours.loc[ours[key].idxmin()], controls.loc[controls[key].idxmin()]
        line = (
            f"{data}, {backend}: {name} of {_label(best)} is {_figure(best[key])} {unit}, "
            f"of the best control, {_label(rival)}, {_figure(rival[key])} {unit}: "
            f"{_relation(float(best[key]), float(rival[key]))}"
        )
        previous = rows[rows.selector == "previous"]
        if not previous.empty and rival.selector != "previous":
            value = float(previous[key].min())
            line += f"; previous {_figure(value)} {unit}, {_relation(float(best[key]), value)}"
        line += _without_registration(table, str(data), key, unit, float(best[key]))
        tries = rows.groupby("selector", sort=False).size()
        if tries.max() > 1:
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
    return f"; no registration {_figure(value)} {unit}, {_relation(ours, value)}"


def _label(row: pd.Series[Any]) -> str:
    details = [f"{k} {row[k]:g}" for k in ("window", "threshold") if _is_number(row.get(k))]
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


def _figure(value: float) -> str:
    """Three significant digits, without an exponent for everyday numbers."""
    return f"{value:.0f}" if 100 <= abs(value) < 1e6 else f"{value:.3g}"


def _stacked(column: str) -> str:
    """A column's name over several lines, so that tables stay narrow."""
    return column.replace("_", "\n")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and value == value


def _is_empty(value: Any) -> bool:
    return value is None or value == "" or (isinstance(value, float) and math.isnan(value))


def _word(value: Any) -> str:
    if _is_empty(value):
        return ""
    if isinstance(value, float):
        whole = abs(value) < 1e6 and (abs(value) >= 1e3 or value == round(value))
        return f"{value:.0f}" if whole else f"{value:.4g}"
    return str(value)
