"""How methods look, the same in every figure: the backend by its colour, the strategy by its
marker and dashes.

Lines differ by dashes and width, markers by shape and filling, so strategies also do in grey;
where backends share axes, words stand beside their colours.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from rbtm_bench.plots import style

GREY = "0.45"


@dataclass(frozen=True)
class Look:
    """``dashes`` as matplotlib's ``linestyle``."""

    dashes: Any
    width: float
    marker: str
    filled: bool = False
    colour: str = "0.25"

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

    def of(self, colour: str) -> Look:
        """The same in a backend's colour."""
        return replace(self, colour=colour)


SELECTORS: dict[str, Look] = {
    "previous": Look((0, (5, 1.5)), 1.3, "o"),
    "keyframe": Look("-", 0.8, "s"),
    "fixed_gap": Look((0, (6, 1.5, 1, 1.5)), 1.3, "^"),
    "oldest": Look((0, (1, 1.2)), 1.5, "v"),
    "random_gap": Look((0, (3, 1.2, 1, 1.2, 1, 1.2)), 1.2, "x"),
    "best": Look((0, (2, 1, 2, 3)), 1.4, "d"),
    "rbtm_verified": Look((0, (7, 2)), 1.1, "H"),
    "oracle": Look((0, (1, 1)), 2.2, "+"),  # sees the truth
    "rbtm": Look("-", 1.8, "D", filled=True),
    "none": Look((0, (8, 1.5)), 1.0, "*", filled=True),  # a whole system
}
OTHERS = (
    Look((0, (4, 1.5)), 1.6, "P", filled=True),
    Look("-", 1.2, "h"),
    Look((0, (5, 1.5, 1, 1.5)), 1.1, "<"),
    Look((0, (1, 1.2)), 1.8, ">"),
    Look((0, (2, 1.2)), 1.1, "p"),
    Look((0, (9, 1.2)), 1.8, "X", filled=True),
)
"""Of selectors of other packages, and of further settings of a selector."""

PALETTE = (
    *(style.BLUE, style.VERMILION, style.GREEN, style.ORANGE, style.PURPLE, style.SKY),
    *(style.BLACK, GREY, style.NAVY),
)
BACKENDS = {
    "open3d_p2p": style.BLUE,
    "plicp_p2p": style.BLUE,
    "small_gicp_icp": style.NAVY,
    "plicp": style.VERMILION,
    "open3d_p2plane": style.VERMILION,
    "small_gicp_plane": style.ORANGE,
    "open3d_gicp": style.GREEN,
    "small_gicp_gicp": style.GREEN,
    "small_gicp_vgicp": style.SKY,
    "ndt_2d": style.PURPLE,
    "open3d_ndt": style.PURPLE,
    "psm": style.ORANGE,
    "hsm": style.SKY,
    "csm_2d": style.NAVY,
    "kiss_icp": style.ORANGE,
    "kiss_icp_system": style.BLACK,
}
"""A family of methods has one colour; of two in one figure the second gets a free one."""


def numbered(number: int) -> Look:
    """Of what is neither a strategy nor a backend, by its place."""
    return OTHERS[number % len(OTHERS)].of(PALETTE[number % len(PALETTE)])


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


def colours(backends: Iterable[str]) -> dict[str, str]:
    """A colour for every backend: its own, or the first free one; beyond nine they repeat."""
    unique = list(dict.fromkeys(backends))
    out: dict[str, str] = {}
    for backend in sorted(unique, key=lambda name: name not in BACKENDS):
        free = [colour for colour in PALETTE if colour not in out.values()] or list(PALETTE)
        own = BACKENDS.get(backend)
        out[backend] = own if own in free else free[0]
    return out
