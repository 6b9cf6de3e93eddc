"""Figures of runs, from the files in their folders, in the formats asked for.

``draw`` decides which figures a set of runs deserves. One kind of figure each: ``maps``,
``occupancy``, ``steps`` and ``matrix`` of a run; ``trajectories``, ``growth``, ``spans``,
``cost`` and ``methods`` of methods side by side; ``heatmaps`` and ``lines`` of a sweep.
``folder`` reads, ``groups`` sorts runs by data set, backend and method, ``studies`` a sweep by
its settings; ``panels`` lays out, ``placing`` places labels, ``labels`` words, ``looks`` and
``style`` say how it looks, ``style`` saves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar

from matplotlib.figure import Figure

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.wording import suggestion
from rbtm_bench.plots import (
    cost,
    groups,
    growth,
    heatmaps,
    labels,
    lines,
    maps,
    matrix,
    methods,
    occupancy,
    spans,
    steps,
    style,
    trajectories,
)
from rbtm_bench.plots.pairs import standard_and_rbtm
from rbtm_bench.plots.studies import SettingsStudy, studies
from rbtm_bench.runs.stored import Run

MANY = 6
"""With more runs than this, figures of single runs are drawn for one run a data set only."""

OF_METHODS: dict[str, Callable[[groups.Data], Iterator[Figure]]] = {
    "trajectories": trajectories.draw,
    "error_over_path": growth.draw,
    "error_over_span": spans.draw,
    "accuracy_time": cost.draw,
}
"""Figures of all methods side by side, a data set at a time."""
OF_RUN = ("map", "occupancy", "gap", "similarity")
KINDS = (*OF_RUN, "standard_beside_rbtm", "errors", *OF_METHODS, "line", "heatmap")
"""What --only knows; a figure's file name ends with its kind."""

Named = tuple[str, str, Callable[[], Iterable[Figure]]]
"""The stem of a figure's file names, its kind, and what makes it."""
T = TypeVar("T")


def draw(
    runs: Sequence[Run],
    out: Path,
    only: Sequence[str] = (),
    drawing: style.Drawing | None = None,
) -> list[Path]:
    """Draw the figures that the runs allow into the folder ``out`` and return the files.

    ``only``: these of ``KINDS``; ``drawing``: style, titles, formats and names. docs/figures.md
    lists the figures, what each shows and when it is made.

    Runs that are not done are left out. Raises ``DataError`` if nothing is left to draw, a file
    is damaged, or ``out`` cannot be written, ``ConfigError`` for an unknown figure.
    """
    for name in only:
        if name not in KINDS:
            raise ConfigError(f"--only {name}: no such figure.{suggestion(name, list(KINDS))}")
    done = [run for run in runs if run.done]
    if not done:
        raise DataError(f"nothing to draw: {_why_none(runs)}")
    written: list[Path] = []
    with style.paper(drawing):
        for stem, kind, make in _figures(list(runs), done):
            if not only or kind in only:
                for name, figure in _numbered(stem, make()):
                    written += style.save(figure, out, name)
    if not written:
        what = " and ".join(only) or "map, steps, similarity or error"
        names = ", ".join(labels.folder_name(run) for run in done[:3])
        raise DataError(f"nothing to draw: no {what} in {names}")
    return written


def _figures(runs: list[Run], done: list[Run]) -> Iterator[Named]:
    """All figures, to be made one at a time: a large map need not wait in memory for others."""
    stems = labels.stems(done)
    for run in done if len(runs) <= MANY else _representatives(done):
        yield from _of_run(stems[run], run)
    for pair in standard_and_rbtm(done):
        yield _one(pair.stem, "standard_beside_rbtm", maps.beside, pair)
    if len(runs) > 2:
        yield "errors", "errors", lambda: _present(methods.errors(runs))
    for data in groups.data_sets(runs):
        for kind, make in OF_METHODS.items():
            yield f"{data.stem}-{kind}", kind, partial(make, data)
    for study in studies(runs):
        kind = "line" if len(study.axes) == 1 else "heatmap"
        yield f"{study.stem}-{kind}", kind, partial(_of_study, study)


def _of_run(stem: str, run: Run) -> Iterator[Named]:
    """Figures of a single run; a system has no selector and chooses no model scan."""
    yield _one(stem, "map", maps.single, run)
    yield _one(stem, "occupancy", occupancy.draw, run)
    if not labels.is_system(run):
        yield _one(stem, "gap", steps.gaps, run)
        yield _one(stem, "similarity", matrix.similarity, run)


def _of_study(study: SettingsStudy) -> Iterable[Figure]:
    return [lines.draw(study)] if len(study.axes) == 1 else heatmaps.draw(study)


def _one(stem: str, kind: str, make: Callable[[T], Figure | None], of: T) -> Named:
    return f"{stem}-{kind}", kind, lambda: _present(make(of))


def _present(figure: Figure | None) -> list[Figure]:
    return [] if figure is None else [figure]


def _numbered(stem: str, figures: Iterable[Figure]) -> Iterator[tuple[str, Figure]]:
    """The figures with their stems; those after the first have a number."""
    for number, figure in enumerate(figures, start=1):
        yield stem + (f"-{number}" if number > 1 else ""), figure


def _representatives(done: list[Run]) -> list[Run]:
    """Of every data set the winner's run and one rbtm run: the first with a real backend, of the
    lowest seed."""
    chosen: dict[Run, None] = {}
    for data in groups.data_sets(done):
        ours = [run for run in data.runs if labels.choice(run, "selector") == "rbtm" and run.done]
        real = [run for run in ours if labels.choice(run, "backend") != "none"] or ours
        if real:
            chosen[min(real, key=labels.seed_order)] = None
        if data.winner is not None:
            chosen[data.winner.runs[0]] = None
    return list(chosen)


def _why_none(runs: Sequence[Run]) -> str:
    if not runs:
        return "no runs given"
    first = runs[0]
    status = str(first.record.get("status"))
    reason = first.record.get("reason")
    detail = f"{status}: {reason}" if reason else status
    return f"none of {len(runs)} run(s) is done ({labels.folder_name(first)} is {detail})"
