"""The figures of a study: the deciding one, errors over an axis, the map of a regime."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from rbtm_bench.core.columns import KNOWN
from rbtm_bench.plots import panels, style
from rbtm_bench.plots.looks import Look, looks
from rbtm_bench.studies.outcome import Outcome
from rbtm_bench.studies.plan import Method
from rbtm_bench.studies.study_file import Study

ROW = 1.35
"""Height of a data set's row, inches."""
MOST = 2.0
"""log2 of the ratio at which the map's colours end: 4 times."""
MAP = LinearSegmentedColormap.from_list("map", [style.BLUE, "#f2f2f2", style.VERMILION])
UNDECIDED = "0.75"
NOTHING = "backend=none"
"""The word of a way that registers nothing."""


def draw(outcome: Outcome, out: Path) -> list[Path]:
    """The figures that the study has data for, as PNG and PDF; returns the PNGs."""
    study = outcome.plan.study
    made: dict[str, Figure] = {}
    with style.paper():
        if not study.axes:
            made["deciding"] = deciding(outcome)
        elif len(study.axes) == 1:
            made["axis"] = over_axis(outcome)
        else:
            for ours in study.ours:
                for other in outcome.others(ours):
                    made[f"map_{ours}_{other}"] = regime(outcome, ours, other)
        files = [file for stem, figure in made.items() for file in style.save(figure, out, stem)]
    return [file for file in files if file.suffix == ".png"]


def looks_of(study: Study) -> dict[str, Look]:
    """A look for every way; that of no registration is a system's."""

    def selector(words: list[str]) -> str:
        named = [word.partition("=")[2] for word in words if word.startswith("selector=")]
        return "none" if NOTHING in words else next(iter(named), "")

    return looks({name: way.selector or selector(way.words) for name, way in study.ways.items()})


def deciding(outcome: Outcome) -> Figure:
    """A data set a row: the log ratio of RBTM to its own gaps at other times, with its interval;
    beside it error against mean gap, every way with all its tries."""
    study, look = outcome.plan.study, looks_of(outcome.plan.study)
    data = [label for label, _, _, _ in study.cells()]
    figure = Figure(figsize=(style.DOUBLE, ROW * len(data) + 1.2))
    widths = [1.15, *[1.0] * len(study.backends)]
    grid = figure.subplots(len(data), len(widths), squeeze=False, width_ratios=widths)
    pairs = [
        (ours, other)
        for ours in study.ours
        for other in outcome.others(ours)
        if study.ways[other].selector == "shifted_gap"
    ]
    comparisons = {ours: outcome.comparisons(ours) for ours in study.ours}
    for row, name in zip(grid, data, strict=True):
        for y, ((ours, other), backend) in enumerate(itertools.product(pairs, study.backends)):
            one = comparisons[ours].get((Method(name, backend, ours), other))
            if one is not None and one.ratio is not None:
                _interval(row[0], y, one.ratio.value, one.ratio.low, one.ratio.high, look[ours])
        names = [
            f"{ours}, {backend}" for (ours, _), backend in itertools.product(pairs, study.backends)
        ]
        row[0].set_yticks(range(len(names)), names)
        row[0].set_ylim(len(names) - 0.5, -0.5)
        row[0].axvline(1.0, color="0.35", lw=0.8)
        _log(row[0], "x")
        row[0].set_title(f"{name} ({study.data[name].status})", loc="left", fontweight="bold")
        for ax, backend in zip(row[1:], study.backends, strict=True):
            for way in study.ways:
                _curve(ax, outcome, Method(name, backend, way), look[way])
            _log(ax, "xy")
            ax.set_title(backend)
    grid[-1][0].set_xlabel(
        "error / that of its own gaps at other\ntimes (below 1: less with RBTM's times)"
    )
    for ax in grid[-1][1:]:
        ax.set_xlabel("mean gap (scans)")
    for row in grid:
        row[1].set_ylabel(_error(study))
    handles = [panels.handle(way, **{**look[way].line, **look[way].mark}) for way in study.ways]
    style.legend_below(figure, handles, 4)
    return figure


def _error(study: Study) -> str:
    column = KNOWN[study.metric]
    return f"error ({column.unit})" if column.unit else column.title


def _interval(
    ax: Axes, y: float, value: float, low: float | None, high: float | None, look: Look
) -> None:
    if low is not None and high is not None:
        ax.plot([low, high], [y, y], color=look.colour, lw=1.2)
    ax.plot([value], [y], ls="", **look.mark)


def _curve(ax: Axes, outcome: Outcome, method: Method, look: Look) -> None:
    """Error against mean gap over the tries of its own key, at the chosen value of what all tune;
    the chosen one large."""
    study, chosen = outcome.plan.study, outcome.chosen[method]
    way = study.ways[method.way]
    own = study.ways[way.like] if way.like else way
    tuned = study.tuned.key if study.tuned else None
    count = len(own.values or [1]) if own.key != tuned else chosen.tried
    first = chosen.k // count * count
    of = {k: (outcome.mean_gap(method, k), chosen.values[k]) for k in range(first, first + count)}
    if NOTHING in way.words:
        if chosen.values[0] == chosen.values[0]:
            ax.axhline(chosen.values[0], **{**look.line, "lw": 0.8})
        return
    points = sorted(point for point in of.values() if not any(map(math.isnan, point)))
    if points:
        ax.plot(*zip(*points, strict=True), **look.line, **{**look.mark, "ms": 2.5, "mew": 0.6})
    if not any(map(math.isnan, of[chosen.k])):
        ax.plot(*([value] for value in of[chosen.k]), ls="", **{**look.mark, "ms": 6})


def _log(ax: Axes, which: str) -> None:
    """Logarithmic axes with as many numbers as stand beside (x) or above one another (y)."""
    for name in which:
        getattr(ax, f"set_{name}scale")("log")
        axis = getattr(ax, f"{name}axis")
        low, high = axis.get_view_interval()
        many, some = (6, 40) if name == "x" else (1000, 10_000)
        span = high / low
        subs = (1.0, 2.0, 5.0) if span < many else (1.0, 3.0) if span < some else (1.0,)
        axis.set_major_locator(LogLocator(subs=subs, numticks=8))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())


def over_axis(outcome: Outcome) -> Figure:
    """The held-out error of every way over the study's one axis, a data set a row."""
    study, look = outcome.plan.study, looks_of(outcome.plan.study)
    ((name, axis),) = study.axes.items()
    figure = Figure(figsize=(style.DOUBLE, 1.9 * len(study.data) + 0.9))
    grid = figure.subplots(len(study.data), len(study.backends), squeeze=False, sharex=True)
    for row, data in zip(grid, study.data, strict=True):
        places = [(at[0], label) for label, own, at, _ in study.cells() if own == data]
        for ax, backend in zip(row, study.backends, strict=True):
            for way in study.ways:
                chosen = [outcome.chosen[Method(label, backend, way)] for _, label in places]
                values = [one.values[one.k] for one in chosen]
                mark = {**look[way].mark, "ms": 3.5}
                ax.plot([k for k, _ in places], values, **look[way].line, **mark)
            _log(ax, "y")
            ax.set_title(f"{data} ({study.data[data].status}), {backend}")
            ax.set_xticks(range(len(axis.values)), [axis.label(k) for k in range(len(axis.values))])
        row[0].set_ylabel(_error(study))
    for ax in grid[-1]:
        ax.set_xlabel(name)
    handles = [panels.handle(way, **{**look[way].line, **look[way].mark}) for way in study.ways]
    style.legend_below(figure, handles, 4)
    return figure


def regime(outcome: Outcome, ours: str, other: str) -> Figure:
    """Where a way has less error than another: the first axis along, the second up, a panel a value
    of the third (columns) and a data set with a backend (rows). Undecided cells are grey."""
    study = outcome.plan.study
    (x, ax_x), (y, ax_y), *third = study.axes.items()
    depth = range(len(third[0][1].values) if third else 1)
    rows = list(itertools.product(study.data, study.backends))
    figure = Figure(figsize=(style.DOUBLE, 1.35 * len(rows) + 1.1))
    grid = figure.subplots(len(rows), len(depth), squeeze=False, sharex=True, sharey=True)
    comparisons = outcome.comparisons(ours)
    norm = TwoSlopeNorm(0.0, -MOST, MOST)
    for (data, backend), line in zip(rows, grid, strict=True):
        for label, own, at, _ in study.cells():
            one = comparisons.get((Method(label, backend, ours), other))
            if own != data or one is None:
                continue
            ratio = one.ours / one.theirs
            shade = MAP(norm(np.clip(np.log2(ratio), -MOST, MOST))) if one.holds else UNDECIDED
            ax = line[at[2] if third else 0]
            corner = (at[0] - 0.5, at[1] - 0.5)
            ax.add_patch(Rectangle(corner, 1, 1, fc=shade, ec="w", lw=1.0))
            words = "=" if one.equal else f"{ratio:.2g}"
            ax.text(at[0], at[1], words, ha="center", va="center", fontsize=6.5)
        for k, ax in zip(depth, line, strict=True):
            ax.set_xlim(-0.5, len(ax_x.values) - 0.5)
            ax.set_ylim(-0.5, len(ax_y.values) - 0.5)
            ax.set_xticks(range(len(ax_x.values)), map(ax_x.label, range(len(ax_x.values))))
            ax.set_yticks(range(len(ax_y.values)), map(ax_y.label, range(len(ax_y.values))))
            where = f", {third[0][0]} {third[0][1].label(k)}" if third else ""
            ax.set_title(f"{data}, {backend}{where}")
        line[0].set_ylabel(y)
    for ax in grid[-1]:
        ax.set_xlabel(x)
    figure.suptitle(
        f"median error of {ours} / that of {other}: blue below 1, red above, grey: not decided, "
        "=: the same by construction"
    )
    return figure
