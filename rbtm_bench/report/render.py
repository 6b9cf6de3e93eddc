"""Tables as text, CSV, Markdown, LaTeX, HTML and JSON."""

from __future__ import annotations

import json
import math
import shutil
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rbtm_bench.core import escape
from rbtm_bench.core.columns import COLUMNS, KNOWN
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.report.frame import METHOD
from rbtm_bench.report.references import accompanied, judged, with_references

if TYPE_CHECKING:
    import pandas as pd

FORMATS = ("text", "csv", "md", "latex", "html", "json")

SHORT = (
    *METHOD,
    "control",
    "seeds",
    "replicates",
    "status",
    *(column.name for column in COLUMNS if column.screen),
)
"""The columns of the table at the end of ``compare``."""

WINNER = "won"
"""The column that marks the winner of a data set with a star."""

ALWAYS = (WINNER, "backend", "selector", "tried")


LAST_TO_GO = (
    *("status", "seeds", "replicates", "coverage", "worst", "quartiles", "control", "decided"),
    "ms_per_scan",
)
"""Columns that a narrow terminal loses last, in this order; before them all others from the right,
except those that are always kept."""
HEAD = 2
"""Characters that tabulate leaves beside a header."""
TOLD = 3
"""Columns left out that are named."""
NARROWEST = 16
"""Characters that a wrapped cell has at least."""


def terminal_width() -> int:
    """Characters of a line: COLUMNS, or those of the terminal, or 100."""
    return shutil.get_terminal_size((100, 24)).columns


def fitted(table: pd.DataFrame, keep: Sequence[str]) -> list[str]:
    """The table as text that fits the terminal, and what it lost for that: columns first, in the
    order of ``LAST_TO_GO``, then the widest words are wrapped once."""
    table = with_references(table)
    table = table[[c for c in table if not all(is_empty(v) for v in table[c])]]
    words = table.map(word_of)
    heads = {c: max(map(len, _stacked(str(c)).split("\n"))) + HEAD for c in table}
    widths = {c: max([heads[c], *map(len, words[c])]) for c in table}
    order = [c for c in reversed(list(table)) if c not in keep and c not in LAST_TO_GO]
    order += [c for c in LAST_TO_GO if c in table and c not in keep]
    dropped: list[str] = []
    while _excess(widths) > 0 and order:
        dropped.append(order.pop(0))
        del widths[dropped[-1]]
    if (over := _excess(widths)) > 0:
        widest = max(widths, key=lambda c: widths[c])
        room = max(widths[widest] - over, NARROWEST)
        cells = [_wrapped(cell, room) for cell in words[widest]]
        table = table.assign(**{widest: cells})
    lines = [render(table[list(widths)], "text")]
    if dropped:
        more = [f"{len(dropped) - TOLD} more"] if len(dropped) > TOLD else []
        words = ", ".join([*map(str, dropped[:TOLD]), *more])
        lines += in_width([f"left out at {terminal_width()} characters (-f csv has all): {words}"])
    return lines


def in_width(lines: Sequence[str]) -> list[str]:
    """Sentences, wrapped for the terminal."""
    wrap = textwrap.TextWrapper(terminal_width(), subsequent_indent="  ", break_on_hyphens=False)
    wrap.break_long_words = False  # paths stay whole
    return [part for line in lines for part in wrap.wrap(line)]


def _excess(widths: dict[str, int]) -> int:
    return sum(widths.values()) + 2 * (len(widths) - 1) - terminal_width()


def _wrapped(cell: str, room: int) -> str:
    """A cell on at most two lines; what does not fit is left out."""
    return "\n".join(textwrap.wrap(cell, room, max_lines=2, placeholder=" ..."))


def render(table: pd.DataFrame, fmt: str) -> str:
    """The table in one of ``FORMATS``. Text, Markdown, LaTeX and HTML leave out columns that are
    empty in every row and round to 4 digits; CSV and JSON keep everything. Numbers that say little
    without those of the truth and of no motion have them in rows at the end."""
    table = with_references(table)
    if fmt == "csv":
        return escape.csv_table(table).to_csv(index=False).rstrip("\n")
    if fmt == "json":
        rows = table.astype(object).to_dict(orient="records")
        return json.dumps(
            [{k: None if is_empty(v) else v for k, v in row.items()} for row in rows], indent=1
        )
    shown = table[[c for c in table if not all(is_empty(v) for v in table[c])]]
    words = shown.map(word_of)
    numeric = {c for c in shown if all(is_numeric_cell(v) or is_empty(v) for v in shown[c])}
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
        words = words.map(escape.markdown)
    return tabulate(
        words.to_numpy().tolist(), headers, tablefmt=kind, colalign=align, disable_numparse=True
    )


def existing_columns(table: pd.DataFrame, names: str) -> list[str]:
    """The columns of a comma list. Raises ``ConfigError`` for one that the table has not."""
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    for name in wanted:
        if name not in table:
            raise ConfigError(f"--columns {name}: no such column. Known: {', '.join(table)}")
    return accompanied(table, wanted)


def screen_table(
    table: pd.DataFrame, columns: Sequence[str] = SHORT, keep: Sequence[str] = ALWAYS
) -> tuple[pd.DataFrame, str]:
    """The columns that fit a screen, and in words those that are the same in every row (unless
    they are to be kept)."""
    shown = table[accompanied(table, [c for c in columns if c in table])]
    if len(table) < 2:
        return shown, ""
    equal = [c for c in shown if len({word_of(v) for v in shown[c]}) == 1]
    if any(c in shown and c not in equal for c in METHOD):  # what tells the rows apart has the room
        keep = [c for c in keep if c not in METHOD or c not in equal]
    keep = (*keep, *accompanied(shown, judged(shown)))
    same = [c for c in equal if c not in keep]
    words = [f"{c} {word_of(shown[c].iloc[0])}" for c in same if word_of(shown[c].iloc[0])]
    return shown.drop(columns=same), ", ".join(words)


def three_digits(value: float) -> str:
    """Three significant digits, without an exponent for everyday numbers."""
    return f"{value:.0f}" if 100 <= abs(value) < 1e6 else f"{value:.3g}"


def _stacked(column: str) -> str:
    """A column's short name over several lines, so that tables stay narrow."""
    short = KNOWN[column].short if column in KNOWN else ""
    return (short or column).replace("_", "\n")


def is_numeric_cell(value: Any) -> bool:
    """True for a number other than NaN."""
    return isinstance(value, int | float) and not isinstance(value, bool) and value == value


def is_empty(value: Any) -> bool:
    return value is None or value == "" or (isinstance(value, float) and math.isnan(value))


def word_of(value: Any) -> str:
    if is_empty(value):
        return ""
    if isinstance(value, float):
        whole = abs(value) < 1e6 and (abs(value) >= 1e3 or value == round(value))
        return f"{value:.0f}" if whole else f"{value:.4g}"
    return str(value)
