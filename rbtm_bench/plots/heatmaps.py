"""The error over two settings of a selector, a panel a backend."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import Stroke

from rbtm_bench.plots import labels, style
from rbtm_bench.plots.studies import LOG_FROM, Cell, SettingsStudy, StudyPanel

WRITTEN = 12
"""Cells a side up to which their values are written into them."""
CELL = (0.34, 0.2)
"""Width and height that a cell with its value needs, inches."""
NUMBER = 6.0
"""Size of the value in it, points."""
PANEL = (1.3, 1.3)
"""Least width and height of a panel, inches."""
COLUMNS = 4
ROOM = (1.4, 1.5)
"""Taken beside and above the panels, inches: axis labels and colour bar, title and legend."""
BETWEEN = (0.15, 0.6)
"""Between panels, inches: tick labels and a title of two lines."""
LINE = 0.13
"""A further line of a title, inches."""
TICKS = 10
"""Tick labels along an axis at most."""
INSET = 0.05
"""Of the frame of the best cell, in cells."""

COLOURS = "viridis_r"
"""Small errors light, large ones dark; in grey as well."""
BEST: dict[str, Any] = {"facecolor": "none", "edgecolor": style.BLACK, "lw": 1.4}
FAILED: dict[str, Any] = {"facecolor": "w", "edgecolor": "0.2", "hatch": "//////", "lw": 0}
MISSING: dict[str, Any] = {"facecolor": "w", "edgecolor": "0.55", "hatch": "....", "lw": 0}


@dataclass(frozen=True, eq=False)
class Layout:
    """What all panels of a study share. ``x`` and ``y`` are the settings' values."""

    x: list[float]
    y: list[float]
    norm: Normalize
    columns: int
    width: float
    high: float

    @property
    def written(self) -> bool:
        """True if the cells are large enough for their values."""
        return max(len(self.x), len(self.y)) <= WRITTEN

    @property
    def panel_width(self) -> float:
        """Inches."""
        return (self.width - ROOM[0] + BETWEEN[0]) / self.columns - BETWEEN[0]


def draw(study: SettingsStudy) -> Iterator[Figure]:
    """The study's panels, all in one colour scale, over as many figures as fit a page each."""
    layout = _layout(study)
    titles = {p: style.wrapped(_words(p, study.unit), layout.panel_width) for p in study.panels}
    line = layout.high + BETWEEN[1] + LINE * max(t.count("\n") - 1 for t in titles.values())
    page = layout.columns * max(1, int((style.TALLEST - ROOM[1]) / line))
    for first in range(0, len(study.panels), page):
        panels = study.panels[first : first + page]
        rows = -(-len(panels) // layout.columns)
        figure = Figure(figsize=(layout.width, rows * line + ROOM[1]))
        grid = figure.subplots(rows, layout.columns, sharex=True, sharey=True, squeeze=False)
        axes: list[Axes] = list(grid.ravel())
        for spare in axes[len(panels) :]:
            spare.remove()
        for number, (ax, panel) in enumerate(zip(axes, panels, strict=False)):
            image = _draw_panel(ax, panel, layout)
            ax.set_title(style.plain(titles[panel]))
            if number + layout.columns >= len(panels):
                ax.tick_params(labelbottom=True)
                ax.set_xlabel(labels.axis(study.axes[0]))
            if number % layout.columns == 0:
                ax.set_ylabel(labels.axis(study.axes[1]))
        _colour_bar(figure, image, axes[: len(panels)], f"{study.error} ({study.unit})")
        part = f"{first // page + 1} of {-(-len(study.panels) // page)}"
        title = study.title if page >= len(study.panels) else f"{study.title} ({part})"
        style.title(figure, title, layout.width)
        style.legend_below(
            figure, _legend(panels, layout), 2 if layout.width == style.SINGLE else 4
        )
        yield figure


def _layout(study: SettingsStudy) -> Layout:
    x, y = study.values(0), study.values(1)
    written = max(len(x), len(y)) <= WRITTEN
    wide, high = PANEL[0], 1.5 * PANEL[1]
    if written:
        wide, high = max(wide, CELL[0] * len(x)), max(PANEL[1], CELL[1] * len(y))
    if len(study.panels) == 1 and wide + ROOM[0] <= style.SINGLE:
        return Layout(x, y, _norm(study.medians), 1, style.SINGLE, max(high, 1.6))
    fit = int((style.DOUBLE - ROOM[0] + BETWEEN[0]) / (wide + BETWEEN[0]))
    columns = max(1, min(fit, len(study.panels), COLUMNS))
    columns = -(
        -len(study.panels) // -(-len(study.panels) // columns)
    )  # 4 panels: 2 x 2, not 3 + 1
    return Layout(x, y, _norm(study.medians), columns, style.DOUBLE, high)


def _words(panel: StudyPanel, unit: str) -> str:
    words = []
    if math.isfinite(panel.best):
        words.append(labels.unbroken(f"best {labels.quantity(panel.best, unit)}"))
    if panel.control is not None:
        words.append(
            labels.unbroken(
                f"{labels.member('selector', 'previous')} {labels.quantity(panel.control, unit)}"
            )
        )
    return "\n".join([panel.name, ", ".join(words)])


def _norm(medians: list[float]) -> Normalize:
    """From the smallest to the largest error; logarithmic where they span more than 20 times."""
    positive = [value for value in medians if value > 0]
    if positive and max(positive) > LOG_FROM * min(medians):
        return LogNorm(min(positive), max(positive), clip=True)  # zeros take the lightest colour
    low, high = min(medians), max(medians)
    return Normalize(low, high if high > low else low + (abs(low) or 1.0), clip=True)


def _draw_panel(ax: Axes, panel: StudyPanel, layout: Layout) -> AxesImage:
    x, y = layout.x, layout.y
    medians = np.full((len(y), len(x)), np.nan)
    ax.add_patch(Rectangle((-0.5, -0.5), len(x), len(y), **MISSING, zorder=0))
    for (a, b), cell in panel.cells.items():
        column, row = x.index(a), y.index(b)
        medians[row, column] = cell.median
        corner = (column - 0.5, row - 0.5)
        if not cell.known:
            ax.add_patch(Rectangle(corner, 1, 1, **FAILED, zorder=1))
        elif cell.median == panel.best:
            _frame(ax, column, row)
    image = ax.imshow(
        np.ma.masked_invalid(medians), norm=layout.norm, cmap=COLOURS, aspect="auto",
        origin="lower", interpolation="nearest", zorder=2,
    )  # fmt: skip
    if layout.written:
        rgb = image.to_rgba(np.nan_to_num(medians))[..., :3]
        light = rgb @ [0.299, 0.587, 0.114] > 0.5
        for (a, b), cell in panel.cells.items():
            column, row = x.index(a), y.index(b)
            _write(ax, column, row, cell, "k" if light[row, column] else "w")
    for axis, values in ((ax.xaxis, x), (ax.yaxis, y)):
        step = -(-len(values) // TICKS)
        axis.set_ticks(range(0, len(values), step), [f"{v:g}" for v in values[::step]])
    ax.tick_params(length=2)
    return image


def _frame(ax: Axes, column: int, row: int) -> None:
    """Mark the best cell: black on white, to be seen on any colour."""
    corner, side = (column - 0.5 + INSET, row - 0.5 + INSET), 1 - 2 * INSET
    white = Stroke(linewidth=3.0, foreground="w")
    frame = Rectangle(corner, side, side, **BEST, path_effects=[white, Stroke()], zorder=4)
    frame.set_joinstyle("miter")
    ax.add_patch(frame)


def _write(ax: Axes, column: int, row: int, cell: Cell, colour: str) -> None:
    """The cell's value; a star says that it is the median of a part of the runs."""
    if cell.known:
        text = short(cell.median) + ("*" if cell.known < cell.runs else "")
        ax.text(
            column, row, text, ha="center", va="center", fontsize=NUMBER, color=colour, zorder=5
        )  # fmt: skip


def short(value: float) -> str:
    """Three digits in few letters: "0.213", "11.5", "156", "61.8k"."""
    if abs(value) >= 9_999.5:
        return f"{float(f'{value / 1000:.3g}'):g}k"
    return f"{value:.0f}" if abs(value) >= 99.95 else f"{float(f'{value:.3g}'):g}"


def _colour_bar(figure: Figure, image: AxesImage, axes: list[Axes], label: str) -> None:
    bar = figure.colorbar(image, ax=axes, label=label, fraction=0.05, pad=0.02, aspect=25)
    if not isinstance(image.norm, LogNorm):
        return
    low, high = float(image.norm.vmin or 1.0), float(image.norm.vmax or 1.0)
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1, 2, 5) if high < 2000 * low else (1,)
    ticks = [t for d in decades for s in steps if low <= (t := float(f"{s}e{d}")) <= high]
    bar.set_ticks(ticks, labels=[short(tick) for tick in ticks])
    bar.minorticks_off()


def _legend(panels: list[StudyPanel], layout: Layout) -> list[Any]:
    cells = [cell for panel in panels for cell in panel.cells.values()]
    handles: list[Any] = [Patch(**BEST, label="best (on this data)")]
    if any(not cell.known for cell in cells):
        handles.append(Patch(**FAILED, label="failed"))
    if any(len(panel.cells) < len(layout.x) * len(layout.y) for panel in panels):
        handles.append(Patch(**MISSING, label="not run"))
    if layout.written and any(0 < cell.known < cell.runs for cell in cells):
        handles.append(
            Line2D([], [], ls="", marker="$*$", color="k", ms=4, label="some runs failed")
        )
    return handles
