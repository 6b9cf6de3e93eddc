"""A run's occupancy grid: what its scans saw through, saw as occupied, and never saw."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from rbtm_bench.plots import labels, maps, style
from rbtm_bench.plots.folder import read_occupancy, read_scene
from rbtm_bench.runs.occupancy import Occupancy
from rbtm_bench.runs.stored import Run

UNKNOWN = "#B9D3E6"
"""Pale blue: no shade of the scale, and a light grey in print."""
FULL = 0.5
"""Share from which on a cell is black. Beams that graze a wall see through many of its cells."""
FINEST = 110
"""Blocks of cells an inch at most: thinner walls would not be seen."""


def draw(run: Run) -> Figure | None:
    """The grid with the trajectory and the truth; None for a run without a grid."""
    grid, scene = read_occupancy(run), read_scene(run)
    if grid is None or scene is None:
        return None
    limits = maps.view([scene])
    figure = Figure(figsize=(style.SINGLE, style.SINGLE))
    ax = figure.add_subplot()
    shown = _blocks(grid, limits)
    _image(ax, shown)
    handles = _legend() + maps.trajectories(ax, scene, width=0.6, band=False)
    maps.frame(ax, limits)
    cell = f"cells of {labels.quantity(grid.cell, 'm')}"
    if shown.cell > grid.cell:
        cell += f", drawn in blocks of {labels.quantity(shown.cell, 'm')} (their fullest cell)"
    lines = [labels.title(run), labels.error_words(run), cell]
    style.title(figure, "\n".join(line for line in lines if line), style.SINGLE)
    style.legend_below(figure, handles, columns=2)
    style.fit_height(figure, [ax], tallest=5.0)
    return figure


def _legend() -> list[Any]:
    look: dict[str, Any] = {"ec": "0.5", "lw": 0.5}
    return [
        Patch(fc=UNKNOWN, **look, label="never seen"),
        Patch(fc="w", **look, label="free in all scans"),
        Patch(fc="0.5", **look, label=f"occupied in {FULL / 2:.0%}"),
        Patch(fc="k", **look, label=f"in {FULL:.0%} or more of the scans"),
    ]


def _image(ax: Axes, grid: Occupancy) -> None:
    share = grid.share
    light = 1 - np.minimum(np.nan_to_num(share) / FULL, 1.0)
    colours = np.repeat(light[..., None], 3, axis=2)
    colours[np.isnan(share)] = to_rgb(UNKNOWN)
    rows, columns = share.shape
    x, y = grid.corner
    ax.imshow(
        colours, extent=(x, x + columns * grid.cell, y, y + rows * grid.cell), origin="lower",
        interpolation="nearest", zorder=1,
    )  # fmt: skip
    ax.set_facecolor(UNKNOWN)


def _blocks(grid: Occupancy, limits: maps.Limits) -> Occupancy:
    """The grid in blocks of cells where the figure could not show single ones. A block is that
    cell of it which the largest share of scans saw as occupied, else thin walls would fade."""
    inches = style.SINGLE - 0.6
    size = math.ceil((limits[1] - limits[0]) / grid.cell / inches / FINEST)
    if size < 2:
        return grid
    rows, columns = (-(-side // size) for side in grid.hits.shape)

    def gathered(values: Any, outside: float) -> Any:
        wide = np.full((rows * size, columns * size), outside, values.dtype)
        wide[: values.shape[0], : values.shape[1]] = values
        split = wide.reshape(rows, size, columns, size).swapaxes(1, 2)
        return split.reshape(rows, columns, size * size)

    share = gathered(np.nan_to_num(grid.share, nan=-1.0), -1.0)
    fullest = np.argmax(share, axis=2)[..., None]
    hits, passed = (
        np.take_along_axis(gathered(counts, 0), fullest, axis=2)[..., 0]
        for counts in (grid.hits, grid.passed)
    )
    return Occupancy(hits, passed, grid.corner, size * grid.cell)
