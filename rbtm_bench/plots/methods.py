"""The error of every method: rows of markers, a panel for every data set and backend."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.ticker import LogLocator, MaxNLocator

from rbtm_bench.plots import labels, style
from rbtm_bench.plots.groups import method_names
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

LOOKS: dict[bool, dict[str, Any]] = {
    True: {"marker": "D", "mfc": style.ORANGE, "mec": style.BLACK, "mew": 0.5, "ms": 4.0},
    False: {"marker": "o", "mfc": "none", "mec": style.BLUE, "mew": 0.9, "ms": 4.5},
}
"""Of rbtm and of its controls."""
MEDIAN: dict[str, Any] = {"marker": "|", "color": style.BLACK, "ms": 11.0, "mew": 1.8}
GUESS: dict[str, Any] = {"color": "0.35", "ls": ":", "lw": 1.2}

Row = tuple[str, bool]
"""A method's name, and whether it is rbtm."""


@dataclass(frozen=True, eq=False)
class MethodErrors:
    """One data set's part of the figure. ``cells`` holds the errors of (backend, row), None for
    a run without one; ``guess`` is the error without any registration, None if that has panels of
    its own."""

    name: str
    unit: str
    error: str
    backends: list[str]
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
    columns, width = columns_and_width(parts)
    heights = [part.height for part in parts]
    figure = Figure(figsize=(width, sum(heights) + 0.7))
    places = figure.subfigures(len(parts), 1, height_ratios=heights, squeeze=False)[:, 0]
    drawn = [
        draw_part(place, part, columns, len(parts) > 1, draw_markers)
        for place, part in zip(places, parts, strict=True)
    ]
    figure.suptitle(style.wrapped(_title(runs, parts), width))
    style.legend_below(figure, _legend(parts), columns=4)
    centre(figure, drawn)
    return figure


def centre(figure: Figure, drawn: Sequence[tuple[Text, list[Axes]]]) -> None:
    """Put the labels under the panels, not under the methods' names. Call it last."""
    figure.draw_without_rendering()
    for label, axes in drawn:
        ends = [ax.get_position() for ax in axes]
        label.set_x((min(p.x0 for p in ends) + max(p.x1 for p in ends)) / 2)


def columns_and_width(parts: Sequence[MethodErrors]) -> tuple[int, float]:
    """Panels in a line, and the figure's width in inches."""
    columns = min(max(len(part.backends) for part in parts), PANELS_IN_A_LINE)
    long_names = max(len(name) for part in parts for name, _ in part.rows) > LONG_NAME
    return columns, style.DOUBLE if columns > 1 or long_names else style.SINGLE


def data_parts(runs: Sequence[Run], settings: bool = True) -> list[MethodErrors]:
    """The data sets whose runs have an error; a row a method, or (without ``settings``) a
    selector."""
    by_data: dict[str, list[Run]] = {}
    for run in runs:
        by_data.setdefault(labels.data_key(run), []).append(run)
    firsts = [group[0] for group in by_data.values()]
    out = []
    for group in by_data.values():
        main_error = labels.main_error([run for run in group if run.done])
        if main_error is None:
            continue
        alike = [r for r in firsts if labels.data_name(r) == labels.data_name(group[0])]
        words = labels.varying(alike, "dataset")[group[0]]
        rows = method_names(group) if settings else _selectors(group)
        name = ", ".join([labels.data_name(group[0]), *words])
        out.append(_data(name, group, rows, main_error))
    return out


def _selectors(runs: Sequence[Run]) -> dict[Run, str]:
    """Coarse names: the selector and the number of its settings."""
    settings: dict[str, set[str]] = {}
    for run, name in method_names(runs).items():
        settings.setdefault(labels.choice(run, "selector"), set()).add(name)
    counts = {selector: len(names) for selector, names in settings.items()}
    words = {s: f"{s} ({n} setting{'s' if n > 1 else ''})" for s, n in counts.items()}
    return {run: words[labels.choice(run, "selector")] for run in runs}


def _data(
    name: str, runs: list[Run], names: dict[Run, str], error: tuple[str, str, str]
) -> MethodErrors:
    key, unit, what = error
    guess = _guess([run for run in runs if labels.choice(run, "backend") == "none"], key)
    if guess is not None and any(labels.choice(run, "backend") != "none" for run in runs):
        runs = [run for run in runs if labels.choice(run, "backend") != "none"]
    else:
        guess = None
    words = labels.varying(runs, "backend")
    title = {run: ", ".join([labels.choice(run, "backend"), *words[run]]) for run in runs}
    cells: dict[tuple[str, Row], list[float | None]] = {}
    for run in sorted(_counted(runs), key=labels.method_order):
        row = (style.wrapped(names[run], NAMES), labels.choice(run, "selector") == "rbtm")
        number = labels.value(run, key) if run.done else None
        cells.setdefault((title[run], row), []).append(number)
    panels = list(dict.fromkeys(title[run] for run in runs))
    rows = list(dict.fromkeys(row for _, row in cells))
    return MethodErrors(name, unit, what, panels, rows, cells, guess)


def _counted(runs: Sequence[Run]) -> list[Run]:
    """The runs that stand for their methods: where there are replicates, those."""
    by_method: dict[str, list[Run]] = {}
    for run in runs:
        by_method.setdefault(run.method, []).append(run)
    return [run for group in by_method.values() for run in counted(group)]


def _guess(runs: Sequence[Run], key: str) -> float | None:
    """The error of runs without registration, if the selector makes no difference to it."""
    known = [number for run in runs if (number := labels.value(run, key)) is not None]
    if not known or max(known) > ONE_VALUE * min(known):
        return None
    return float(np.median(known))


def draw_part(
    place: Figure | SubFigure,
    part: MethodErrors,
    columns: int,
    named: bool,
    draw_panel: Callable[[Axes, MethodErrors, str], None],
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
        draw_panel(ax, part, part.backends[number])
        ax.set_title(style.plain(part.backends[number]))
        if number + columns >= len(part.backends):
            ax.tick_params(labelbottom=True)
    if named:
        place.suptitle(style.plain(part.name))
    label = place.supxlabel(f"{part.error} ({part.unit})", fontsize=style.FONT)
    return label, list(axes.ravel()[: len(part.backends)])


def draw_markers(ax: Axes, part: MethodErrors, backend: str) -> None:
    """A row of markers a method, one a run, and a line at their median."""
    for height, row in enumerate(part.rows):
        ax.axhline(height, color="0.88", lw=0.5, zorder=0)
        runs = part.cells.get((backend, row), [])
        values = [value for value in runs if value is not None]
        if not values:
            remark(ax, height, "no result" if runs else "not run", values)
            continue
        if len(values) < len(runs):
            remark(ax, height, f"{len(values)} of {len(runs)} runs", values)
        if len(values) > 1:
            ax.plot(np.median(values), height, ls="", **MEDIAN, zorder=2)
        ax.plot(values, [height] * len(values), ls="", **LOOKS[row[1]], zorder=3)
    if part.guess is not None:
        ax.axvline(part.guess, **GUESS, zorder=1)


def remark(ax: Axes, height: int, words: str, values: list[float]) -> None:
    """Words in a row, at the end that is farther from its markers; above them if both are full."""
    markers = [ax.transData.transform((value, height))[0] for value in values]
    left, right = ax.transAxes.transform([(0, 0), (1, 0)])[:, 0]
    room = {"left": min(markers, default=right) - left, "right": right - max(markers, default=left)}
    side = max(room, key=lambda name: room[name])
    if room[side] < style.inches(words) * ax.figure.dpi * 1.2:
        ax.text(
            0.5, height - 0.2, words, transform=ax.get_yaxis_transform(),
            ha="center", va="bottom", c="0.35", fontsize=0.75 * style.FONT,
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
    text = f"{data}: {errors} by method, one marker a run"
    failed = sum(not run.done for run in runs)
    return text + (f" ({failed} of {len(runs)} runs are not done)" if failed else "")


def _legend(parts: list[MethodErrors]) -> list[Line2D]:
    kinds = {is_rbtm for part in parts for _, is_rbtm in part.rows}
    words = {True: "rbtm", False: "control"}
    out = [Line2D([], [], ls="", **LOOKS[kind], label=words[kind]) for kind in sorted(kinds)]
    if any(len(runs) > 1 for part in parts for runs in part.cells.values()):
        out.append(Line2D([], [], ls="", **MEDIAN, label="median"))
    if any(part.guess is not None for part in parts):
        out.append(Line2D([], [], **GUESS, label="backend none: the guess alone"))
    return out
