"""Text of others (names, reasons, what a library says) made harmless for where it is written."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    import pandas as pd

_CONTROLS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")
"""C0 and C1 controls but tab and newline, and what turns the direction of writing."""
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_LATEX = {
    "\\": "\\textbackslash{}", "{": "\\{", "}": "\\}", "~": "\\textasciitilde{}",
    "^": "\\textasciicircum{}", "<": "\\textless{}", ">": "\\textgreater{}",
    "\N{DAGGER}": "\\dag{}", "\N{DOUBLE DAGGER}": "\\ddag{}",
    "\N{DEGREE SIGN}": "\\textdegree{}", "\N{EN DASH}": "--",
    **{letter: f"\\{letter}" for letter in "&%$#_"},
}  # fmt: skip
_MARKDOWN = {"|": "\\|", "&": "&amp;", "<": "&lt;", ">": "&gt;"}


def terminal(text: str) -> str:
    """Text without control sequences: each of their characters as \\x1b; tabs and lines stay."""
    return _CONTROLS.sub(lambda m: m[0].encode("unicode_escape").decode(), text)


def csv(text: str) -> str:
    """A cell of text that no spreadsheet takes for a formula."""
    return f"'{text}" if text.startswith(_FORMULA) else text


def csv_table(table: pd.DataFrame) -> pd.DataFrame:
    """The table with its text made so; numbers stay the numbers that they are."""
    import pandas as pd
    from pandas.api.types import is_numeric_dtype

    of_text = {}
    for name in table.columns:
        if not is_numeric_dtype(table[name]):  # whole numbers beside nothing would become fractions
            cells = [csv(value) if isinstance(value, str) else value for value in table[name]]
            of_text[name] = pd.Series(cells, index=table.index, dtype=object)
    return table.assign(**of_text)


def markdown(text: str) -> str:
    """Text that stays text in a cell of a Markdown table: no tag, no bar, one line."""
    return "".join(_MARKDOWN.get(letter, letter) for letter in terminal(" ".join(text.split())))


def latex(text: str) -> str:
    """Text that LaTeX prints as it is."""
    return "".join(_LATEX.get(letter, letter) for letter in terminal(text))


class Terminal:
    """A stream to which text of others may be written: ``terminal`` sees all of it first."""

    def __init__(self, stream: TextIO) -> None:
        self.rich_proxied_file = stream
        """Where a progress bar of rich draws: past this, its words made harmless by ``engine``."""

    def write(self, text: str) -> int:
        self.rich_proxied_file.write(terminal(text))
        return len(text)

    def writelines(self, lines: Any) -> None:
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.rich_proxied_file, name)


@contextmanager
def harmless_output() -> Iterator[None]:
    """Standard output and error as ``Terminal`` for this long, where they are there at all."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (
        one if one is None or isinstance(one, Terminal) else Terminal(one) for one in before
    )
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
