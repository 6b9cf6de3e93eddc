"""Basins of convergence: the share of right answers over the size of the guess's error."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from rbtm_bench.plots import style

Shares = Mapping[tuple[float, float], float]
"""(m, deg) of the guess's error -> share of right answers."""

COLUMNS = 4
PANEL = (1.55, 1.45)
"""Width and height of a panel, inches."""
ROOM = (0.6, 0.9)
"""For labels, title and colour bar, inches."""
COLOURS = "Greys_r"
DARK = 50.0
"""Percentages below this are written in white."""


def draw(by_backend: Mapping[str, Shares], title: str) -> Figure:
    """A panel a backend, all over the same errors, in one grey scale."""
    columns = min(COLUMNS, len(by_backend))
    rows = -(-len(by_backend) // columns)
    size = (columns * PANEL[0] + ROOM[0], rows * PANEL[1] + ROOM[1])
    figure = Figure(figsize=size)
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    image = None
    for ax, (name, shares) in zip(axes.flat, by_backend.items(), strict=False):
        image = _panel(ax, shares)
        ax.set_title(style.plain(name))
    for ax in list(axes.flat)[len(by_backend) :]:
        ax.set_axis_off()
    figure.supxlabel("rotation error of the initial guess (deg)", fontsize=style.font())
    figure.supylabel("translation error of the initial guess (m)", fontsize=style.font())
    if image is not None:
        figure.colorbar(image, ax=list(axes.flat), label="found (%)", shrink=0.6)
    style.title(figure, title, size[0])
    return figure


def _panel(ax: Axes, shares: Shares) -> AxesImage:
    metres, degrees = sorted({m for m, _ in shares}), sorted({d for _, d in shares})
    grid = np.array([[100.0 * shares[m, d] for d in degrees] for m in metres])
    image = ax.imshow(grid, cmap=COLOURS, vmin=0.0, vmax=100.0, origin="lower", aspect="auto")
    middle: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 6}
    for (row, column), percent in np.ndenumerate(grid):
        colour = "white" if percent < DARK else "black"
        ax.text(column, row, f"{percent:.0f}", color=colour, **middle)
    ax.set_xticks(range(len(degrees)), [f"{d:g}" for d in degrees])
    ax.set_yticks(range(len(metres)), [f"{m:g}" for m in metres])
    return image
