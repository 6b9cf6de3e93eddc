"""How figures look, and how they are saved.

Figures are made without pyplot, so no backend is ever chosen and no global state is kept:
``Figure.savefig`` takes the Agg and PDF canvases by itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.textpath import TextPath

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.files import write_atomically
from rbtm_bench.report.names import Names

SINGLE = 3.4
"""Width of a paper's column, inches."""
DOUBLE = 7.0
"""Width over both columns, inches."""
MARGIN = 0.12
"""Left free on either side of a title, inches."""
TALLEST = 8.5
"""Height that still fits a page, inches."""

FONT = 8.0

# Colours of Okabe and Ito 2008 (safe for the colour-blind); their greys differ as well.
BLACK = "#000000"
ORANGE = "#E69F00"
VERMILION = "#D55E00"
BLUE = "#0072B2"
NAVY = "#003F73"
SKY = "#56B4E9"
GREEN = "#009E73"
PURPLE = "#CC79A7"

RASTER_FROM = 5_000
"""Markers from which on a PDF holds pixels instead of that many paths."""

FORMATS: dict[str, dict[str, Any]] = {
    "png": {"dpi": 150},
    "pdf": {"dpi": 300, "metadata": {"CreationDate": None}},
    "svg": {"dpi": 300, "metadata": {"Date": None}},
}
"""Dots an inch (in a PDF: of its rasterised parts); no date, so that the same runs give the same
file."""

PAPER: dict[str, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib
    "font.size": FONT,
    "axes.titlesize": FONT,
    "axes.labelsize": FONT,
    "xtick.labelsize": FONT,
    "ytick.labelsize": FONT,
    "legend.fontsize": FONT,
    "figure.titlesize": FONT,
    "figure.constrained_layout.use": True,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "hatch.linewidth": 0.6,
    "legend.frameon": False,
    "legend.handletextpad": 0.5,
    "legend.columnspacing": 1.2,
    "pdf.fonttype": 42,
    "ps.fonttype": 42,
    "svg.hashsalt": "rbtm_bench",
}
TALK = 1.3
"""Of a talk's letters, lines and markers, of a paper's."""


@dataclass(frozen=True)
class Drawing:
    """How figures are drawn: ``style`` "paper" or "talk", with ``titles`` above or without (a
    caption says it), in these ``formats``, by these ``names`` (None: those of the package)."""

    style: str = "paper"
    titles: bool = True
    formats: Sequence[str] = ("png", "pdf")
    names: Names | None = None


_drawing: ContextVar[Drawing] = ContextVar("drawing", default=Drawing())  # noqa: B039, frozen
_default_names = lru_cache(Names.read)


def names() -> Names:
    """The readable names of this drawing."""
    return _drawing.get().names or _default_names()


def font() -> float:
    """Points of a letter."""
    return FONT * (TALK if _drawing.get().style == "talk" else 1.0)


@contextmanager
def paper(drawing: Drawing | None = None) -> Iterator[None]:
    """The look of our figures, whatever the user's own matplotlibrc says; undone at the end."""
    before = _drawing.set(drawing or Drawing())
    sizes = {key: font() for key, value in PAPER.items() if value == FONT}
    try:
        with matplotlib.style.context(["default", PAPER | sizes]):
            yield
    finally:
        _drawing.reset(before)


def title(figure: Figure, text: str, width: float) -> None:
    """Words above a figure of so many inches, unless a caption is to say them."""
    if _drawing.get().titles and text:
        figure.suptitle(wrapped(text, width))


def wrapped(text: str, width: float) -> str:
    """Text broken into lines that fit ``width`` inches; line breaks in it stay."""
    lines: list[str] = []
    limit = width - 2 * MARGIN
    for paragraph in plain(text).splitlines():
        line = ""
        for word in _pieces(paragraph.split(" "), limit):
            longer = f"{line} {word}" if line else word
            if line and inches(longer) > limit:
                lines.append(line)
                longer = word
            line = longer
        lines.append(line)
    return "\n".join(lines)


def _pieces(words: Sequence[str], width: float) -> Iterator[str]:
    """The words, those too wide for a line in parts, cut behind a hyphen if they have one."""
    for word in words:
        while inches(word) > width:
            fits = next(n for n in range(len(word) - 1, 0, -1) if inches(word[:n]) <= width)
            cut = word.rfind("-", 1, fits) + 1 or fits
            yield word[:cut]
            word = word[cut:]
        yield word


def plain(text: str) -> str:
    """Text in which matplotlib finds no formula."""
    return text.replace("$", r"\$")


def inches(text: str) -> float:
    """Width of a line of text in our font, without kerning."""
    return sum(map(_letter, text)) / 72 * font() / FONT


@lru_cache
def _letter(letter: str) -> float:
    """Width of a letter, points, with the space around it."""
    widths = [
        TextPath((0, 0), text, size=FONT).get_extents().width for text in (f"|{letter}|", "||")
    ]
    return float(widths[0] - widths[1])


def fit_height(figure: Figure, columns: Sequence[Axes], tallest: float) -> None:
    """Give the figure the height that its panels of fixed aspect need, no more.

    ``columns`` are the axes above each other, which fill the width; ``tallest`` (inches) bounds
    each of them. Call it last: titles and legends need their room too.
    """
    for _ in range(3):  # again with the margins as they are then
        figure.draw_without_rendering()
        width, height = figure.get_size_inches()
        for ax in columns:
            (x0, x1), (y0, y1) = ax.get_xlim(), ax.get_ylim()
            place = ax.get_position(original=True)
            aspect = ax.get_aspect()
            stretch = aspect if isinstance(aspect, float) else 1.0
            wanted = place.width * width * stretch * abs(y1 - y0) / abs(x1 - x0)
            wanted = min(wanted, tallest)
            height += wanted - place.height * figure.get_figheight()
        figure.set_size_inches(width, max(height, 1.5))


def legend_below(figure: Figure, handles: list[Any], columns: int) -> None:
    """A legend under the axes, where it cannot cover data."""
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=min(columns, len(handles)))


def save(figure: Figure, out: Path, stem: str) -> list[Path]:
    """Write the figure in the formats of this drawing; each appears whole or not at all.

    Raises ``DataError`` if they cannot be written.
    """
    written = []
    if _drawing.get().style == "talk":
        for line in figure.findobj(Line2D):
            line.set_linewidth(TALK * line.get_linewidth())
            line.set_markersize(TALK * line.get_markersize())
    try:
        out.mkdir(parents=True, exist_ok=True)
        for ending in _drawing.get().formats:
            options = FORMATS[ending]
            path = out / f"{stem}.{ending}"
            write_atomically(path, partial(figure.savefig, format=ending, **options))
            written.append(path)
    except OSError as error:
        raise DataError(f"{out}: cannot be written: {error.strerror or error}") from error
    return written
