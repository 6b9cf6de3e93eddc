"""How the error grows: the APE of every scan over the true path, a panel a backend."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from rbtm_bench.core.types import Array
from rbtm_bench.metrics.ape import Ape
from rbtm_bench.plots import groups, labels, panels, style
from rbtm_bench.plots.folder import Paths, read_paths
from rbtm_bench.plots.groups import Data, Panel
from rbtm_bench.plots.looks import GUESS, Look, looks
from rbtm_bench.runs.stored import Run

COLUMNS = 3
TALL = 2.0
"""Height of a panel, inches."""
LOG_FROM = 10.0
"""Largest over smallest of the methods' largest errors from which on the axis is logarithmic."""
SHOWN = 0.1
"""Part of the smallest of them down to which a logarithmic axis goes: errors begin at zero."""
LARGE = 10.0
"""m from which on m are the better unit than mm."""
TRAVELLED = 1e-3
"""m; a truth that moved less is drawn over time."""
BAND: dict[str, Any] = {"alpha": 0.16, "lw": 0}
BANDS = 3
"""Methods up to which bands stay distinct; of more, only the medians are drawn."""
BINS = 50
"""Points of a line at most: errors of single scans of a corridor make a fence of it."""
MARKS = 6
"""Markers along a line."""

ALIGNED = {
    "origin": "first poses made equal",
    "umeyama": "fitted without scale",
    "none": "as given",
}
"""How estimate and truth are aligned, in words."""


@dataclass(frozen=True, eq=False)
class ErrorCourse:
    """The errors of a method's runs. ``x`` (N,) m or s; ``errors`` (R, N) m, a row a seed."""

    x: Array
    errors: Array

    @property
    def median(self) -> Array:
        return np.asarray(np.median(self.errors, axis=0))

    @property
    def variation(self) -> float:
        """How far the median goes up and down in all, m."""
        return float(np.abs(np.diff(self.median)).sum())


def draw(data: Data) -> Iterator[Figure]:
    """Medians over seeds as lines; for up to 3 methods, bands from the smallest to the largest.
    Nothing for runs without ground truth."""
    few, note = data.few()
    align = _align(data.runs)
    moving = _moving(few)
    courses = {
        (panel.name, method.name): course
        for panel in few.panels
        for method in panel.methods
        if (course := _course(method.counted, align, moving)) is not None
    }
    if not courses:
        return
    guess = _course([data.guess], align, moving) if data.guess is not None else None
    highest = [float(course.errors.max()) for course in courses.values()]
    unit, per = ("m", 1.0) if max(highest) >= LARGE else ("mm", 1e3)
    own, colours = looks(few.methods), few.colours
    seeds = max(len(course.errors) for course in courses.values())
    banded = seeds > 1 and max(len(panel.methods) for panel in few.panels) <= BANDS

    def panel(ax: Axes, panel: Panel) -> None:
        if guess is not None:
            ax.plot(guess.x, per * guess.median, **GUESS, label="guess", zorder=1)
        names = [m.name for m in panel.methods if (panel.name, m.name) in courses]
        names.sort(key=lambda name: -courses[panel.name, name].variation)  # the restless below
        for level, name in enumerate(names):
            phase = level / len(names)
            look = own[name].of(colours[panel.name])
            _draw_course(ax, name, courses[panel.name, name], per, look, phase)
            if banded:
                _draw_band(ax, courses[panel.name, name], per, look)
        ax.set_xlabel("true path (m)" if moving else "time (s)")
        ax.set_ylabel(f"position error ({unit})")
        ax.xaxis.set_major_locator(MaxNLocator(5))
        _scale(ax, [per * value for value in highest])

    words = [f"{data.name}: position error of every scan (APE), {ALIGNED[align]}", note]
    if seeds > 1:
        words.append(f"median of {seeds} {groups.repeats(data.runs)}")
    title = ", ".join(word for word in words if word)
    handles = _handles(own, banded, guess is not None)
    yield from panels.pages(few.panels, COLUMNS, TALL, panel, title, handles)


def _draw_course(
    ax: Axes, name: str, course: ErrorCourse, per: float, look: Look, phase: float
) -> None:
    every = max(1, len(course.x) // MARKS)
    first = min(int(phase * every) + every // 2, len(course.x) - 1)
    mark = {**look.mark, "ms": 3.5, "mew": 0.8, "markevery": (first, every)}
    ax.plot(course.x, per * course.median, **look.line, **mark, label=name, zorder=3)


def _draw_band(ax: Axes, course: ErrorCourse, per: float, look: Look) -> None:
    low, high = course.errors.min(axis=0), course.errors.max(axis=0)
    ax.fill_between(course.x, per * low, per * high, color=look.colour, **BAND, zorder=2)


def _scale(ax: Axes, highest: Sequence[float]) -> None:
    positive = [value for value in highest if value > 0]
    if positive and max(positive) > LOG_FROM * min(positive):
        ax.set_yscale("log", nonpositive="mask")
        ax.set_ylim(SHOWN * min(positive), 1.5 * max(positive))
    else:
        ax.set_ylim(0.0, 1.05 * max(highest) or 1.0)


def _handles(own: dict[str, Look], band: bool, guess: bool) -> list[Any]:
    handles: list[Any] = [
        panels.handle(name, **look.line, **look.mark) for name, look in own.items()
    ]
    if band:
        handles.append(Patch(color=style.BLACK, **BAND, label="smallest to largest"))
    if guess:
        handles.append(panels.handle(labels.member("backend", "none"), **GUESS))
    return handles


def _course(runs: Sequence[Run], align: str, moving: bool) -> ErrorCourse | None:
    """The errors of the runs that have a truth. Of many scans, and where replicates begin at
    different ones, medians of ``BINS`` equal parts of the path."""
    every: list[tuple[Array, Array]] = []
    for run in runs:
        paths = read_paths(run)
        if paths is None or paths.truth is None:
            continue
        errors = Ape(cast(Literal["none", "origin", "umeyama"], align)).distances(
            paths.estimate, paths.truth
        )
        if errors is not None:
            every.append((_abscissa(paths, moving), errors))
    if not every:
        return None
    first = every[0][0]
    same = all(len(x) == len(first) and np.allclose(x, first) for x, _ in every)
    if same and len(first) <= BINS:
        return ErrorCourse(first, np.stack([errors for _, errors in every]))
    edges = np.linspace(0.0, max(float(x[-1]) for x, _ in every), BINS + 1)
    binned = np.full((len(every), BINS), np.nan)
    for row, (x, errors) in zip(binned, every, strict=True):
        place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, BINS - 1)
        for part in np.unique(place):
            row[part] = np.median(errors[place == part])
    whole = ~np.isnan(binned).any(axis=0)  # the end of the path is not reached by all
    return ErrorCourse((0.5 * (edges[1:] + edges[:-1]))[whole], binned[:, whole])


def _abscissa(paths: Paths, moving: bool) -> Array:
    """The length (N,) m of the true path up to every scan, or the time (N,) s since the first."""
    assert paths.truth is not None
    if not moving:
        return paths.truth.stamps - paths.truth.stamps[0]
    steps = np.diff(paths.truth.T_world_scan[:, :3, 3], axis=0)
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])


def _moving(data: Data) -> bool:
    for panel in data.panels:
        for method in panel.methods:
            paths = read_paths(method.runs[0])
            if paths is not None and paths.truth is not None:
                return bool(_abscissa(paths, moving=True)[-1] >= TRAVELLED)
    return True


def _align(runs: Sequence[Run]) -> str:
    """How the runs' own APE was aligned: "origin" unless all say otherwise."""
    alignments = {(labels.section(run, "metrics").get("ape") or {}).get("align") for run in runs}
    return (
        str(alignments.pop()) if len(alignments) == 1 and alignments <= set(ALIGNED) else "origin"
    )
