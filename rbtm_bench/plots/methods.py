"""The error of every method: rows of markers, a panel for every data set and backend."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text
from matplotlib.ticker import LogLocator, MaxNLocator

from rbtm_bench.plots import labels, style
from rbtm_bench.plots.groups import as_asked, by_data, order, repeats
from rbtm_bench.plots.looks import GUESS, Look, colours, looks
from rbtm_bench.report import frame
from rbtm_bench.report.replicates import counted
from rbtm_bench.runs.stored import Run

PANELS_IN_A_LINE = 4
LOG_FROM = 20.0
"""Largest over smallest error from which on the axis is logarithmic."""
ROW = 0.06
LINE = 0.13
"""Height of a method's row, inches: for itself, and for every line of its name."""
LONG_NAME = 18
"""Letters of a name from which on one column is too narrow."""
NAMES = 2.4
"""Width of the methods' names at most, inches."""
ONE_VALUE = 1.02
"""Largest over smallest error of backend "none" up to which a line stands for all of them."""

QUARTILES = 4
"""Runs from which on quartiles mean something."""
ALL = 15
"""Runs from which on the single ones are not drawn beside the box any more."""
THICK = 0.62
"""Of a box, in rows."""
BOX_WHITE = 0.75
"""How much white is in a box's colour."""
EDGE: dict[str, Any] = {"ec": "0.3", "lw": 0.7}
WHISKER: dict[str, Any] = {"color": "0.3", "lw": 0.7}
MEDIAN: dict[str, Any] = {"marker": "|", "color": style.BLACK, "ms": 10.0, "mew": 1.8}

Row = tuple[str, str]
"""A method's name and its selector."""


@dataclass(frozen=True, eq=False)
class MethodErrors:
    """One data set's part of the figure: ``backends`` are the panels with their colours,
    ``cells`` the errors of (backend, row), None for a run without one; ``guess`` is the error
    without any registration, None if that has panels of its own."""

    name: str
    unit: str
    error: str
    backends: dict[str, str]
    rows: list[Row]
    cells: dict[tuple[str, Row], list[float | None]]
    guess: float | None

    @property
    def lines(self) -> int:
        return -(-len(self.backends) // PANELS_IN_A_LINE)

    @property
    def height(self) -> float:
        """Inches."""
        lines = max(name.count("\n") + 1 for name, _ in self.rows)
        return self.lines * ((ROW + LINE * lines) * len(self.rows) + 0.4) + 0.55

    @property
    def values(self) -> list[float]:
        """All of them, the guess alone included."""
        all_of_them = [*(v for values in self.cells.values() for v in values), self.guess]
        return [v for v in all_of_them if v is not None]


def errors(runs: Sequence[Run]) -> Figure | None:
    """Errors by method; None if no run has one. Every data set has an axis of its own, with the
    first of ``tables.ERRORS`` that its runs have."""
    parts = data_parts(runs, settings=True)
    if sum(part.height for part in parts) > style.TALLEST:  # too many settings for a row each
        parts = data_parts(runs, settings=False)
    if not parts:
        return None
    columns, width = _columns_and_width(parts)
    heights = [part.height for part in parts]
    figure = Figure(figsize=(width, sum(heights) + 0.7))
    places = figure.subfigures(len(parts), 1, height_ratios=heights, squeeze=False)[:, 0]
    drawn = [
        _draw_part(place, part, columns, len(parts) > 1)
        for place, part in zip(places, parts, strict=True)
    ]
    style.title(figure, _title(runs, parts), width)
    style.legend_below(figure, _legend(parts), columns=4)
    _centre(figure, drawn)
    return figure


def _centre(figure: Figure, drawn: Sequence[tuple[Text, list[Axes]]]) -> None:
    """Put the labels under the panels, not under the methods' names. Call it last."""
    figure.draw_without_rendering()
    for label, axes in drawn:
        ends = [ax.get_position() for ax in axes]
        label.set_x((min(p.x0 for p in ends) + max(p.x1 for p in ends)) / 2)


def _columns_and_width(parts: Sequence[MethodErrors]) -> tuple[int, float]:
    """Panels in a line, and the figure's width in inches."""
    columns = min(max(len(part.backends) for part in parts), PANELS_IN_A_LINE)
    long_names = max(len(name) for part in parts for name, _ in part.rows) > LONG_NAME
    return columns, style.DOUBLE if columns > 1 or long_names else style.SINGLE


def data_parts(runs: Sequence[Run], settings: bool = True) -> list[MethodErrors]:
    """The data sets whose runs have an error; a row a method, or (without ``settings``) a
    selector. Methods of which every run failed have a row too."""
    out = []
    for _, name, group in by_data(runs):
        main_error = labels.main_error([run for run in group if run.done])
        if main_error is not None:
            out.append(_data(name, group, settings, main_error))
    return out


def _data(name: str, runs: list[Run], settings: bool, error: tuple[str, str, str]) -> MethodErrors:
    key, unit, what = error
    names = style.names()
    alone = [run for run in runs if labels.choice(run, "backend") == "none"]
    guess = _guess([run for m in frame.methods(alone) for run in counted(m.runs)], key)
    real = [run for run in runs if labels.choice(run, "backend") != "none"]
    if guess is not None and real:
        runs = real
    else:
        guess = None
    methods = sorted(frame.methods(runs), key=order)
    counts = Counter(method.row["selector"] for method in methods)
    cells: dict[tuple[str, Row], list[float | None]] = {}
    backends: dict[str, str] = {}
    for method in methods:
        selector = method.row["selector"]
        n = counts[selector]
        coarse = f"{names.of('selector', selector)} ({n} setting{'s' if n > 1 else ''})"
        own = names.method(as_asked(method)) if settings else coarse
        row = (style.wrapped(own, NAMES), selector)
        panel = names.backend(method.row)
        backends[panel] = method.row["backend"]
        numbers = [labels.value(run, key) if run.done else None for run in counted(method.runs)]
        cells.setdefault((panel, row), []).extend(numbers)
    colour = colours(backends.values())
    known = names.order("backend", backends.values())
    panels = {
        p: colour[backends[p]] for p in sorted(backends, key=lambda p: known.index(backends[p]))
    }
    rows = list(dict.fromkeys(row for _, row in cells))
    return MethodErrors(name, unit, what, panels, rows, cells, guess)


def _guess(runs: Sequence[Run], key: str) -> float | None:
    """The error of runs without registration, if the selector makes no difference to it."""
    by_selector: dict[str, list[float]] = {}
    for run in runs:
        if (number := labels.value(run, key)) is not None:
            by_selector.setdefault(labels.choice(run, "selector"), []).append(number)
    medians = [float(np.median(numbers)) for numbers in by_selector.values()]
    if not medians or max(medians) > ONE_VALUE * min(medians):
        return None
    return float(np.median(medians))


def _draw_part(
    place: Figure | SubFigure, part: MethodErrors, columns: int, named: bool
) -> tuple[Text, list[Axes]]:
    """All panels of one data set, with one scale; returns their common label and them."""
    axes = place.subplots(part.lines, columns, sharex=True, sharey=True, squeeze=False)
    _scale(axes[0, 0], part.values)
    axes[0, 0].set_yticks(range(len(part.rows)), [name for name, _ in part.rows])
    axes[0, 0].set_ylim(len(part.rows) - 0.4, -0.6)
    for number, ax in enumerate(axes.ravel()):
        if number >= len(part.backends):
            ax.remove()
            continue
        backend = list(part.backends)[number]
        _draw_panel(ax, part, backend)
        ax.set_title(style.plain(backend))
        if number + columns >= len(part.backends):
            ax.tick_params(labelbottom=True)
    if named:
        place.suptitle(style.plain(part.name))
    label = place.supxlabel(f"{part.error} ({part.unit})", fontsize=style.font())
    return label, list(axes.ravel()[: len(part.backends)])


def _draw_panel(ax: Axes, part: MethodErrors, backend: str) -> None:
    """A row of markers a method, one a run, a line at their median, a box over their quartiles."""
    colour = part.backends[backend]
    own = {row: look.of(colour) for row, look in _looks(part).items()}
    for height, row in enumerate(part.rows):
        ax.axhline(height, color="0.88", lw=0.5, zorder=0)
        runs = part.cells.get((backend, row), [])
        values = [value for value in runs if value is not None]
        if not values:
            remark(ax, height, "no result" if runs else "not run", values)
            continue
        if len(values) < len(runs):
            remark(ax, height, f"{len(values)} of {len(runs)} runs", values)
        if len(values) >= QUARTILES:
            pale = [1 - (1 - BOX_WHITE) * (1 - part_of) for part_of in to_rgb(colour)]
            ax.boxplot(
                values, positions=[height], orientation="horizontal", widths=THICK, whis=(0, 100),
                manage_ticks=False, patch_artist=True, boxprops={**EDGE, "fc": pale},
                medianprops={"lw": 0}, whiskerprops=WHISKER, capprops=WHISKER, zorder=1,
            )  # fmt: skip
        if len(values) > 1:
            ax.plot(np.median(values), height, ls="", **MEDIAN, zorder=4)
        if len(values) < ALL:
            small = {"ms": 3.2, "mew": 0.6} if len(values) >= QUARTILES else {}
            mark = {**own[row].mark, **small}
            ax.plot(values, [height] * len(values), ls="", **mark, zorder=3)
    if part.guess is not None:
        ax.axvline(part.guess, **GUESS, zorder=1)


def _looks(part: MethodErrors) -> dict[Row, Look]:
    """The marker of every row: its selector's."""
    first = looks({selector: selector for _, selector in part.rows})
    return {row: first[row[1]] for row in part.rows}


def remark(ax: Axes, height: int, words: str, values: list[float]) -> None:
    """Words in a row, at the end that is farther from its markers; above them if both are full."""
    markers = [ax.transData.transform((value, height))[0] for value in values]
    left, right = ax.transAxes.transform([(0, 0), (1, 0)])[:, 0]
    room = {"left": min(markers, default=right) - left, "right": right - max(markers, default=left)}
    side = max(room, key=lambda name: room[name])
    if room[side] < style.inches(words) * ax.figure.dpi * 1.2:
        ax.text(
            0.5, height - 0.2, words, transform=ax.get_yaxis_transform(),
            ha="center", va="bottom", c="0.35", fontsize=0.75 * style.font(),
        )  # fmt: skip
        return
    ax.text(
        0.02 if side == "left" else 0.98, height, words, transform=ax.get_yaxis_transform(),
        ha=side, va="center", c="0.35", bbox={"fc": "w", "ec": "none", "pad": 1.0},
    )  # fmt: skip


def _scale(ax: Axes, values: list[float]) -> None:
    """Logarithmic where the errors span more than 20 times; zeros then lie on a linear foot."""
    positive = [v for v in values if v > 0]
    if positive and max(values) > LOG_FROM * min(positive):
        if min(values) > 0:
            ax.set_xscale("log")
            ax.xaxis.set_major_locator(LogLocator(numticks=6))
            ax.set_xlim(min(values) / 1.6, max(values) * 1.6)
        else:
            ax.set_xscale("symlog", linthresh=min(positive))
            ax.set_xlim(-0.3 * min(positive), max(values) * 1.6)
        return
    ax.set_xlim(0, 1.08 * max(values) or 1.0)
    ax.xaxis.set_major_locator(MaxNLocator(4))


def _title(runs: Sequence[Run], parts: list[MethodErrors]) -> str:
    data = parts[0].name if len(parts) == 1 else f"{len(parts)} data sets"
    errors = " and ".join(dict.fromkeys(part.error for part in parts))
    text = f"{data}: {errors} by method"
    most = max(len(cell) for part in parts for cell in part.cells.values())
    text += f", {most} {repeats(runs)}" if most > 1 else ""
    failed = sum(not run.done for run in runs)
    return text + (f" ({failed} of {len(runs)} runs are not done)" if failed else "")


def _legend(parts: list[MethodErrors]) -> list[Any]:
    most = max(len(runs) for part in parts for runs in part.cells.values())
    out: list[Any] = []
    if most > 1:
        out.append(Line2D([], [], ls="", **MEDIAN, label="median"))
    if most >= QUARTILES:
        out.append(Patch(fc="0.85", **EDGE, label="quartiles, smallest to largest"))
    if any(part.guess is not None for part in parts):
        words = labels.member("backend", "none")
        out.append(Line2D([], [], **GUESS, label=words))
    return out
