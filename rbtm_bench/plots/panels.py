"""Pages of panels, one a backend, all over the same axes, with one legend."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from rbtm_bench.plots import style
from rbtm_bench.plots.groups import Panel

KEY = 0.55
"""Width of a legend's sign with the space around it, inches."""
ROOM = 0.9
"""Height for title, axis label and legend, inches."""
LINE = 0.14
"""Height of a line of text, inches."""


def pages(
    panels: Sequence[Panel],
    columns: int,
    height: float,
    draw: Callable[[Axes, Panel], None],
    title: str,
    handles: list[Any],
    equal: bool = False,
) -> Iterator[Figure]:
    """Figures with the panels drawn by ``draw``, as many as fit a page each.

    ``height`` (inches) is that of a panel with its title; with ``equal`` panels take what their
    aspect needs, at most that.
    """
    columns = -(-len(panels) // -(-len(panels) // columns))  # 4 panels: 2 x 2, not 3 + 1
    width = style.SINGLE if columns == 1 else style.DOUBLE
    beside = abreast(handles, width)
    room = ROOM + LINE * -(-len(handles) // beside)
    lines = max(1, int((style.TALLEST - room) / height))
    for first in range(0, len(panels), lines * columns):
        shown = list(panels[first : first + lines * columns])
        rows = -(-len(shown) // columns)
        figure = Figure(figsize=(width, rows * height + room))
        grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        axes: list[Axes] = list(grid.ravel())
        for number, (ax, panel) in enumerate(zip(axes, shown, strict=False)):
            draw(ax, panel)
            ax.set_title(style.wrapped(panel.name, (width - 0.5) / columns))
            if number + columns < len(shown):
                ax.set_xlabel("")
            else:
                ax.tick_params(labelbottom=True)
            if number % columns:
                ax.set_ylabel("")
        for spare in axes[len(shown) :]:
            spare.remove()
        style.title(figure, title, width)
        style.legend_below(figure, handles, beside)
        if equal:
            style.fit_height(figure, list(grid[:, 0]), tallest=height)
        yield figure


def abreast(handles: Sequence[Any], width: float) -> int:
    """Entries of a legend that fit beside each other into ``width`` inches."""
    widest = max((style.inches(str(entry.get_label())) for entry in handles), default=1.0) + KEY
    return max(1, min(int((width - 0.1) / widest), len(handles)))


def handle(label: str, **look: Any) -> Line2D:
    """A legend's sign."""
    return Line2D([], [], label=style.plain(label), **look)
