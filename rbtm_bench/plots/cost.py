"""Accuracy against time: the error of every method over its time a scan, and the Pareto front."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from rbtm_bench.plots import groups, labels, panels, style
from rbtm_bench.plots.groups import Data
from rbtm_bench.plots.heatmaps import short
from rbtm_bench.plots.looks import GUESS, Look, looks
from rbtm_bench.plots.placing import Label, place

TIME = "ms_per_scan"
WIDE = 5
"""Backends from which on both columns are taken."""
FAR = 1e6
"""Factor to a place beyond the axes."""
FRONT: dict[str, Any] = {"color": "0.45", "lw": 1.4, "ls": "-"}
LINK: dict[str, Any] = {"lw": 0.6, "ls": "-", "alpha": 0.6}
"""Between the methods of a backend."""
SPREAD: dict[str, Any] = {"lw": 0.8, "ls": "-"}
"""From quartile to quartile of the error."""
FEWEST = 4
"""Runs from which on quartiles mean something."""
PARTIAL = 0.35
"""Opacity of a method of which a run failed."""


@dataclass(frozen=True, eq=False)
class CostPoint:
    """Medians over a method's runs: ``time`` ms a scan, ``error`` in the data set's unit, with its
    ``quartiles`` over four runs or more. ``whole`` is False if a run failed, or has no error."""

    backend: str
    method: str
    time: float
    error: float
    whole: bool
    quartiles: tuple[float, float] | None = None

    def scaled(self, factor: float) -> CostPoint:
        """The same in another unit."""
        ends = self.quartiles
        ends = None if ends is None else (factor * ends[0], factor * ends[1])
        return replace(self, error=factor * self.error, quartiles=ends)


def draw(data: Data) -> Iterator[Figure]:
    """The figure; nothing for fewer than two methods with an error and a time above zero."""
    main_error = labels.main_error([run for run in data.runs if run.done])
    if main_error is None:
        return
    key, unit, name = main_error
    points = read(data, key)
    if len(points) < 2:
        return
    guess = labels.value(data.guess, key) if data.guess is not None else None
    if unit == "mm" and max(point.error for point in points) >= labels.LARGE:
        points = [point.scaled(1e-3) for point in points]
        unit, guess = "m", None if guess is None else 1e-3 * guess
    width = style.SINGLE if len(data.panels) < WIDE else style.DOUBLE
    figure = Figure(figsize=(width, 3.4 if width == style.SINGLE else 4.2))
    ax = figure.add_subplot()
    ax.set(xlabel="time a scan (ms)", ylabel=f"{name} ({unit})", xscale="log", yscale="log")
    own, colours = _by_selector(data), data.colours
    for point in points:
        colour = colours[point.backend]
        look = own[point.method].of(colour).mark | ({} if point.whole else {"alpha": PARTIAL})
        if point.quartiles is not None:
            ax.plot([point.time] * 2, point.quartiles, color=colour, **SPREAD, zorder=3)
        ax.plot(point.time, point.error, **look, ls="", zorder=4)
    best = front(points)
    corners = _draw_front(ax, best)
    top = _limits(ax, points)
    if guess is not None and guess <= top:
        ax.axhline(guess, **GUESS, zorder=1)
    names = [
        Label(backend, places, colours[backend]) for backend, places in _link(ax, points, colours)
    ]
    style.title(figure, _title(data), width)
    handles = _handles(data, own, points)
    if guess is not None and guess <= top:
        handles.append(panels.handle(labels.member("backend", "none"), **GUESS))
    elif guess is not None:
        far = (
            f"{labels.member('backend', 'none')}: {labels.quantity(guess, unit)} \N{UPWARDS ARROW}"
        )
        ax.text(0.98, 0.98, far, transform=ax.transAxes, ha="right", va="top", color="0.25")
    style.legend_below(figure, handles, panels.abreast(handles, width))
    place(figure, ax, names, [(p.time, p.error) for p in points], corners)
    yield figure


def _title(data: Data) -> str:
    most = max(len(method.counted) for panel in data.panels for method in panel.methods)
    medians = f"medians of {most} {groups.repeats(data.runs)}" if most > 1 else ""
    medians += " (bars: quartiles)" if most >= FEWEST else ""
    return ", ".join(filter(None, [f"{data.name}: accuracy against time", medians]))


def _link(
    ax: Axes, points: Sequence[CostPoint], colours: dict[str, str]
) -> list[tuple[str, tuple[tuple[float, float], ...]]]:
    """Join the points of a backend by a thin line; returns its name and their places."""
    places: dict[str, tuple[tuple[float, float], ...]] = {}
    for point in sorted(points, key=lambda p: p.time):  # so that a line crosses none of its own
        places[point.backend] = (*places.get(point.backend, ()), (point.time, point.error))
    for backend, line in places.items():
        ax.plot(*zip(*line, strict=True), color=colours[backend], **LINK, zorder=1)
    return list(places.items())


def read(data: Data, key: str) -> list[CostPoint]:
    """A point for every method that has both an error and a time above zero."""
    out = []
    for panel in data.panels:
        for method in panel.methods:
            both = [(labels.value(run, TIME), labels.value(run, key)) for run in method.counted]
            known = [(t, e) for t, e in both if t is not None and e is not None]
            if known:
                time, error = np.median(known, axis=0)
                whole = len(known) == len(both) and not method.failed
                ends = np.quantile([e for _, e in known], [0.25, 0.75]).tolist()
                ends = (ends[0], ends[1]) if len(known) >= FEWEST else None
                name = panel.name, method.name
                out.append(CostPoint(*name, float(time), float(error), whole, ends))
    return [point for point in out if point.time > 0 and point.error > 0]


def front(points: Sequence[CostPoint]) -> list[CostPoint]:
    """The methods that none beats in both, by time; those of which a run failed do not count."""
    best: list[CostPoint] = []
    for point in sorted(points, key=lambda p: (p.time, p.error)):
        if point.whole and (not best or point.error < best[-1].error):
            best.append(point)
    return best


def _draw_front(ax: Axes, best: Sequence[CostPoint]) -> list[tuple[float, float]]:
    """A step line: until the time of its next point nothing better is to be had. Returns its
    corners."""
    if not best:
        return []
    corners = [(best[0].time, FAR * best[0].error)]
    for point, after in zip(best, [*best[1:], None], strict=True):
        corners.append((point.time, point.error))
        corners.append((after.time if after else FAR * point.time, point.error))
    ax.plot(*zip(*corners, strict=True), **FRONT, zorder=2, label="Pareto front")
    return corners


def _limits(ax: Axes, points: Sequence[CostPoint]) -> float:
    """Give the axes room around the points and few, round numbers; returns the largest error
    that is still inside."""
    top = 0.0
    for axis, values in (
        (ax.xaxis, [point.time for point in points]),
        (ax.yaxis, [point.error for point in points]),
    ):
        low, high = min(values), max(values)
        pad = max((high / low) ** 0.12, 1.3)
        low, top = low / pad, high * pad
        (ax.set_xlim if axis is ax.xaxis else ax.set_ylim)(low, top)
        subs = (1.0, 2.0, 5.0) if top < 300 * low else (1.0,)
        axis.set_major_locator(LogLocator(subs=subs, numticks=12))
        if top < 8 * low:  # too few powers of ten and their like
            axis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        axis.set_major_formatter(FuncFormatter(lambda value, _: short(value)))
        axis.set_minor_formatter(NullFormatter())
    return top


def _by_selector(data: Data) -> dict[str, Look]:
    """A look for every method: that of the first one of its selector."""
    first: dict[str, str] = {}
    for name, selector in data.methods.items():
        first.setdefault(selector, name)
    own = looks({name: selector for selector, name in first.items()})
    return {name: own[first[selector]] for name, selector in data.methods.items()}


def _handles(data: Data, own: dict[str, Look], points: Sequence[CostPoint]) -> list[Any]:
    marks = {selector: own[name].mark for name, selector in reversed(data.methods.items())}
    out = [
        panels.handle(style.names().of("selector", selector), ls="", **mark)
        for selector, mark in reversed(marks.items())
    ]
    out.append(panels.handle("Pareto front", **FRONT))
    if not all(point.whole for point in points):
        look = {"marker": "o", "mfc": "w", "mec": style.BLACK, "alpha": PARTIAL, "ms": 4.5}
        out.append(panels.handle("some runs failed", ls="", **look))
    return out
