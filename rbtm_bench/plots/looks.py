"""How methods look, the same in every figure: a line, a marker and a colour each.

Lines differ by dashes and width, markers by shape and filling, so both also do in grey.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rbtm_bench.plots import style

GREY = "0.45"


@dataclass(frozen=True)
class Look:
    """``dashes`` as matplotlib's ``linestyle``."""

    colour: str
    dashes: Any
    width: float
    marker: str
    filled: bool = False

    @property
    def line(self) -> dict[str, Any]:
        return {"color": self.colour, "ls": self.dashes, "lw": self.width}

    @property
    def mark(self) -> dict[str, Any]:
        fill = self.colour if self.filled else "w"
        edge = style.BLACK if self.filled else self.colour
        # crosses have no inside: their lines take the colour
        mark = {"marker": self.marker, "mfc": fill, "mec": edge, "mew": 0.9, "ms": 4.5}
        return mark | ({"mec": self.colour, "mew": 1.3} if self.marker in "x+1" else {})


SELECTORS: dict[str, Look] = {
    "previous": Look(style.BLUE, (0, (5, 1.5)), 1.3, "o"),
    "keyframe": Look(style.BLACK, "-", 0.8, "s"),
    "fixed_gap": Look(style.SKY, (0, (6, 1.5, 1, 1.5)), 1.3, "^"),
    "oldest": Look(style.NAVY, (0, (1, 1.2)), 1.5, "v"),
    "random_gap": Look(GREY, (0, (3, 1.2, 1, 1.2, 1, 1.2)), 1.2, "x"),
    "best": Look(style.ORANGE, (0, (2, 1, 2, 3)), 1.4, "d"),
    "rbtm_verified": Look(style.VERMILION, (0, (7, 2)), 1.1, "H"),
    "oracle": Look(style.BLACK, (0, (1, 1)), 2.2, "+"),  # sees the truth
    "rbtm": Look(style.VERMILION, "-", 1.8, "D", filled=True),
    "none": Look(style.BLACK, (0, (8, 1.5)), 1.0, "*", filled=True),  # a whole system
}
OTHERS = (
    Look(style.ORANGE, (0, (4, 1.5)), 1.6, "P", filled=True),
    Look(GREY, "-", 1.2, "h"),
    Look(style.NAVY, (0, (5, 1.5, 1, 1.5)), 1.1, "<"),
    Look(style.ORANGE, (0, (1, 1.2)), 1.8, ">"),
    Look(style.BLUE, (0, (2, 1.2)), 1.1, "p"),
    Look(style.SKY, "-", 1.8, "X", filled=True),
)
"""Of selectors of other packages, and of further settings of a selector."""

TRUTH: dict[str, Any] = {"color": "0.78", "lw": 4.5, "ls": "-", "solid_capstyle": "round"}
"""A pale band below everything, so that a line upon it is seen to be right."""
GUESS: dict[str, Any] = {"color": "0.35", "lw": 1.0, "ls": (0, (1, 1.5))}
"""Of what comes out without any registration."""


def looks(methods: Mapping[str, str]) -> dict[str, Look]:
    """A look for every method by its name; ``methods`` holds names and selectors, in order. The
    first method of a known selector has the selector's own."""
    out: dict[str, Look] = {}
    used = 0
    for name, selector in methods.items():
        look = SELECTORS.get(selector)
        if look is None or look in out.values():
            look, used = OTHERS[used % len(OTHERS)], used + 1
        out[name] = look
    return out
