"""How many times smaller than the standard way's an error is, over three settings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from rbtm_bench.plots import heatmaps, style

NUMBER = 6.0
"""Size of the value in a cell, points."""
EQUAL = 0.05
"""Ratios within 5% are written as 1."""
TICKS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)


@dataclass(frozen=True)
class Ratio:
    """A cell of the ratio's grid."""

    scans: int
    noise_mm: float
    distance_m: float
    ratio: float


def draw(rows: Sequence[tuple[str, Sequence[Ratio]]], title: str, theirs: float) -> Figure:
    """Ratios over the number of scans (x) and the correspondence distance (y), a panel a noise,
    a row of panels a comparison; ``theirs`` is marked on the scale."""
    cells = [cell for _, ratios in rows for cell in ratios]
    noises = sorted({cell.noise_mm for cell in cells})
    finite = [cell.ratio for cell in cells if math.isfinite(cell.ratio)]
    norm = LogNorm(min(1.0, *finite), max(theirs * 1.2, *finite))
    figure = Figure(figsize=(style.DOUBLE, 0.9 + 1.75 * len(rows)))
    axes = figure.subplots(len(rows), len(noises), sharex=True, sharey=True, squeeze=False)
    for line, (name, ratios) in zip(axes, rows, strict=True):
        for ax, noise in zip(line, noises, strict=True):
            image = _panel(ax, [cell for cell in ratios if cell.noise_mm == noise], norm)
        line[0].set_ylabel(f"{name}\nICP distance (m)")
    for ax, noise in zip(axes[0], noises, strict=True):
        ax.set_title("no noise" if noise == 0 else f"range noise {noise:g} mm")
    for ax in axes[-1]:
        ax.set_xlabel("number of scans")
    bar = figure.colorbar(image, ax=list(axes.ravel()), fraction=0.03, pad=0.02, aspect=30)
    bar.set_label("standard ICP's error over this one's")
    ends = float(norm.vmin or 0), float(norm.vmax or 0)
    ticks = [tick for tick in TICKS if ends[0] <= tick <= ends[1]]
    bar.set_ticks(ticks, labels=[written(tick) for tick in ticks])
    bar.minorticks_off()
    bar.ax.axhline(theirs, color="w", lw=2.6)
    bar.ax.axhline(theirs, color=style.BLACK, lw=1.2)
    handles: list[Any] = [
        Line2D([], [], color=style.BLACK, lw=1.2, label=f"on the scale: the paper's {theirs:.0f}"),
        Line2D([], [], ls="", label="1/2: error twice the standard ICP's"),
    ]
    style.title(figure, title, style.DOUBLE)
    style.legend_below(figure, handles, columns=2)
    return figure


def _panel(ax: Axes, cells: Sequence[Ratio], norm: LogNorm) -> Any:
    x = sorted({cell.scans for cell in cells})
    y = sorted({cell.distance_m for cell in cells})
    values = np.full((len(y), len(x)), np.nan)
    for cell in cells:
        values[y.index(cell.distance_m), x.index(cell.scans)] = cell.ratio
    ax.add_patch(Rectangle((-0.5, -0.5), len(x), len(y), **heatmaps.FAILED, zorder=0))
    image = ax.imshow(
        np.ma.masked_invalid(values), norm=norm, cmap=heatmaps.COLOURS, aspect="auto",
        origin="lower", interpolation="nearest", zorder=1,
    )  # fmt: skip
    dark = image.to_rgba(np.nan_to_num(values, nan=1.0))[..., :3] @ [0.299, 0.587, 0.114] < 0.5
    for row, column in zip(*np.nonzero(np.isfinite(values)), strict=True):
        text = written(float(values[row, column]))
        ax.text(
            column, row, text, ha="center", va="center", fontsize=NUMBER, zorder=2,
            color="w" if dark[row, column] else "k",
        )  # fmt: skip
    ax.set_xticks(range(len(x)), [str(value) for value in x])
    ax.set_yticks(range(len(y)), [f"{value:g}" for value in y])
    ax.tick_params(length=2)
    return image


def written(ratio: float) -> str:
    """Two digits: "150", "3.7", and "1/3.7" for what is larger than the standard way's."""
    if abs(math.log(ratio)) < EQUAL:
        return "1"
    return f"1/{written(1 / ratio)}" if ratio < 1 else f"{float(f'{ratio:.2g}'):g}"
