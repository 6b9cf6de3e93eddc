"""How the error of every method spreads over seeds: box plots, a panel a backend."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from rbtm_bench.plots import groups, methods, style
from rbtm_bench.plots.methods import MethodErrors
from rbtm_bench.runs.stored import Run

LEAST = 4
"""Runs from which on quartiles mean something."""
ALL = 10
"""Runs from which on the single ones are not drawn any more."""
THICK = 0.6
"""Of a box, in rows."""
ROOMY = 1.2
"""Height of a row, of that of a row of markers."""
APART = (0.0, 0.17, -0.17)
"""In rows: neighbouring runs stand beside each other."""
BOX: dict[bool, dict[str, Any]] = {
    True: {"facecolor": style.ORANGE, "edgecolor": style.BLACK, "lw": 0.8},
    False: {"facecolor": "0.9", "edgecolor": style.BLACK, "lw": 0.8},
}
"""Of rbtm and of its controls."""
MEDIAN: dict[str, Any] = {"color": style.BLACK, "lw": 2.0}
WHISKER: dict[str, Any] = {"color": style.BLACK, "lw": 0.8}
RUN: dict[str, Any] = {
    "ls": "", "marker": "o", "mfc": "w", "mec": style.BLACK, "mew": 0.7, "ms": 2.8
}  # fmt: skip


def draw(runs: Sequence[Run]) -> Iterator[tuple[str, Figure]]:
    """A figure with its file stem for every data set that has a method of at least 4 seeds, and
    no more methods than fit a page."""
    for stem, _, group in groups.by_data(runs):
        parts = methods.data_parts(group)
        if not parts or ROOMY * parts[0].height > style.TALLEST:
            continue
        (part,) = parts
        if max(len(values(part, *place)) for place in part.cells) < LEAST:
            continue
        columns, width = methods.columns_and_width(parts)
        figure = Figure(figsize=(width, ROOMY * part.height + 0.7))
        place = figure.subfigures(1, 1, squeeze=False)[0, 0]
        drawn = methods.draw_part(place, part, columns, False, _draw_panel)
        n = _same_n(part)
        each = "n runs a method" if n is None else f"n = {n} runs a method"
        title = f"{part.name}: {part.error} over {groups.repeats(group)}, {each}"
        figure.suptitle(style.wrapped(title, width))
        style.legend_below(figure, _legend(part), columns=4 if width == style.DOUBLE else 2)
        methods.centre(figure, [drawn])
        yield stem, figure


def values(part: MethodErrors, backend: str, row: methods.Row) -> list[float]:
    """The errors of a method that are known."""
    return [value for value in part.cells.get((backend, row), []) if value is not None]


def _same_n(part: MethodErrors) -> int | None:
    """How many runs every method has, None if they differ or one has no result."""
    counts = {len(values(part, *place)) for place in part.cells}
    counts |= {len(runs) for runs in part.cells.values()}
    return counts.pop() if len(counts) == 1 else None


def _draw_panel(ax: Axes, part: MethodErrors, backend: str) -> None:
    for height, row in enumerate(part.rows):
        ax.axhline(height, color="0.88", lw=0.5, zorder=0)
        runs, errors = part.cells.get((backend, row), []), values(part, backend, row)
        if not errors:
            methods.remark(ax, height, "no result" if runs else "not run", errors)
            continue
        if len(errors) >= LEAST:
            ax.boxplot(
                errors, positions=[height], orientation="horizontal", widths=THICK, whis=(0, 100),
                manage_ticks=False, patch_artist=True, boxprops=BOX[row[1]], medianprops=MEDIAN,
                whiskerprops=WHISKER, capprops=WHISKER, zorder=2,
            )  # fmt: skip
        if len(errors) < ALL:
            beside = [height + APART[i % len(APART)] for i in range(len(errors))]
            ax.plot(sorted(errors), beside, **RUN, zorder=3)
        if _same_n(part) is None:
            many = "" if len(errors) == len(runs) else f" of {len(runs)}"
            methods.remark(ax, height, f"n = {len(errors)}{many}", errors)
    if part.guess is not None:
        ax.axvline(part.guess, **methods.GUESS, zorder=1)


def _legend(part: MethodErrors) -> list[Any]:
    counts = [len(values(part, *place)) for place in part.cells]
    out: list[Any] = [
        Patch(**BOX[kind], label=f"quartiles, {'rbtm' if kind else 'control'}")
        for kind in sorted({is_rbtm for _, is_rbtm in part.rows}, reverse=True)
    ]
    out += [Line2D([], [], **MEDIAN, label="median")]
    out += [Line2D([], [], **WHISKER, label="smallest to largest")]
    if min(counts) < ALL:
        out.append(Line2D([], [], **RUN, label="a run"))
    if part.guess is not None:
        out.append(Line2D([], [], **methods.GUESS, label="the guess alone"))
    return out
