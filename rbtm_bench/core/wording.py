"""Settings in words, as one would type them."""

from __future__ import annotations

import difflib
from typing import Any


def suggestion(word: str, known: list[str]) -> str:
    """ " Did you mean x? Known: ..." for a mistyped word."""
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    meant = f" Did you mean {close[0]}?" if close else ""
    return f"{meant} Known: {', '.join(known) if known else '(none)'}"


def shown(value: Any) -> str:
    """A value as one would type it."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f"[{','.join(map(shown, value))}]"
    return str(value)
