"""Text of others (names, reasons, what a library says) made harmless for where it is written."""

from __future__ import annotations

import re

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
_MARKDOWN = {"|": "\\|", "<": "&lt;", ">": "&gt;", "\n": " ", "\r": " "}


def terminal(text: str) -> str:
    """Text without control sequences: each of their characters as \\x1b; tabs and lines stay."""
    return _CONTROLS.sub(lambda m: m[0].encode("unicode_escape").decode(), text)


def csv(text: str) -> str:
    """A cell of text that no spreadsheet takes for a formula."""
    return f"'{text}" if text.startswith(_FORMULA) else text


def markdown(text: str) -> str:
    """Text for a cell of a Markdown table: no tag, no bar, one line."""
    return "".join(_MARKDOWN.get(letter, letter) for letter in terminal(text))


def latex(text: str) -> str:
    """Text that LaTeX prints as it is."""
    return "".join(_LATEX.get(letter, letter) for letter in terminal(text))
