"""How the error of a log grows with time: relation error over the relations' span."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter
from numpy.typing import NDArray

from rbtm_bench.core.types import Array
from rbtm_bench.metrics.relation_errors import FILE, RelationErrors
from rbtm_bench.plots import labels, panels
from rbtm_bench.plots.groups import Data, Panel
from rbtm_bench.plots.looks import GUESS, looks
from rbtm_bench.runs.stored import Run

COLUMNS = 3
TALL = 2.0
"""Height of a panel, inches."""
BINS = 5
"""Of local and of long relations at most, with equally many in each."""
FEWEST_RELATIONS = 20
"""Relations that a median is taken over at least."""
LOCAL_S = 30.0
"""Where local relations end unless the run's settings say otherwise, s."""
TIMES = (1.0, 10.0, 60.0, 600.0, 3600.0)
"""Where an axis of time has its ticks, s."""
UNITS = ((1.0, "s"), (60.0, "min"), (3600.0, "h"))


@dataclass(frozen=True, eq=False)
class Curve:
    """``span`` (B,) s, the median one of a bin; ``error`` (B,) m, the median error in it."""

    span: Array
    error: Array


def draw(data: Data) -> Iterator[Figure]:
    """Medians over bins of the span |end - start|, a line a method, a panel a backend. Nothing
    for runs without relations."""
    few, note = data.few()
    curves: dict[tuple[str, str], Curve] = {}
    for panel in few.panels:
        for method in panel.methods:
            line = curve(method.runs[0])
            if line is not None:
                curves[panel.name, method.name] = line
    if not curves:
        return
    guess = curve(data.guess) if data.guess is not None else None
    own, colours = looks(few.methods), few.colours
    errors = [e for line in curves.values() for e in line.error.tolist() if e > 0] or [1.0]
    local_s = float(labels.section(few.runs[0], "metrics").get("relations", {}).get("local_s") or 0)
    local_s = local_s or LOCAL_S

    def panel_of(ax: Axes, panel: Panel) -> None:
        ax.axvline(local_s, color="0.8", lw=0.8, zorder=0)
        if guess is not None:
            ax.plot(guess.span, guess.error, **GUESS, zorder=1)
        for method in panel.methods:
            line = curves.get((panel.name, method.name))
            if line is not None:
                look = own[method.name].of(colours[panel.name])
                mark = {**look.mark, "ms": 3.5, "mew": 0.8}
                ax.plot(line.span, line.error, **look.line, **mark, label=method.name, zorder=3)
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_ylim(0.5 * min(errors), 2.0 * max(errors))  # what has no motion is right at once
        ax.xaxis.set_major_locator(FixedLocator(TIMES))
        ax.xaxis.set_major_formatter(FuncFormatter(_time))
        ax.set_xlabel("time between the two scans")
        ax.set_ylabel("relation error (m)")

    words = [f"{data.name}: error of reference relations over their span, medians of bins", note]
    handles: list[Any] = [panels.handle(n, **look.line, **look.mark) for n, look in own.items()]
    if guess is not None:
        handles.append(panels.handle(labels.member("backend", "none"), **GUESS))
    handles.append(panels.handle(f"local up to {local_s:g} s", color="0.8", lw=0.8))
    title = ", ".join(word for word in words if word)
    yield from panels.pages(few.panels, COLUMNS, TALL, panel_of, title, handles)


def curve(run: Run) -> Curve | None:
    """The run's relations by span, local and long ones apart, at least ``FEWEST_RELATIONS`` a
    bin; None without as many."""
    if not (run.path / FILE).is_file():
        return None
    relations = RelationErrors.read(run.path / FILE)
    span, error = np.abs(relations.end - relations.start), relations.translation_m
    parts: list[NDArray[np.intp]] = []
    for kind in (relations.used & relations.local, relations.used & ~relations.local):
        order = np.flatnonzero(kind)[np.argsort(span[kind], kind="stable")]
        bins = min(BINS, len(order) // FEWEST_RELATIONS)
        parts += np.array_split(order, bins) if bins else []
    if not parts:
        return None
    return Curve(
        np.array([np.median(span[part]) for part in parts]),
        np.array([np.median(error[part]) for part in parts]),
    )


def _time(seconds: float, _: int) -> str:
    """ "10 s", "5 min", "2.8 h"."""
    per, unit = next((u for u in reversed(UNITS) if seconds >= u[0]), UNITS[0])
    return f"{seconds / per:.2g}\N{NO-BREAK SPACE}{unit}"
