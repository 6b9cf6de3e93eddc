"""Figures of runs, from the files in their folders, each as PNG and PDF.

``draw`` decides which figures a set of runs deserves. One kind of figure each: ``maps``,
``occupancy``, ``steps`` and ``matrix`` of a run; ``trajectories``, ``growth``, ``spans``,
``cost``, ``methods`` and ``boxes`` of methods side by side; ``heatmaps`` and ``lines`` of a sweep.
``folder`` reads, ``groups`` sorts runs by data set, backend and method, ``studies`` a sweep by
its settings; ``panels`` lays out, ``placing`` places labels, ``labels`` words, ``looks`` and
``style`` say how it looks, ``style`` saves.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from rbtm_bench.core.errors import DataError
from rbtm_bench.plots import (
    boxes,
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
from rbtm_bench.plots.studies import studies
from rbtm_bench.runs.stored import Run

MANY = 6
"""With more runs than this, figures of single runs are drawn for one run a data set only."""

Named = tuple[str, Figure]
"""The stem of a figure's file names, and the figure."""


def draw(runs: Sequence[Run], out: Path) -> list[Path]:
    """Draw the figures that the runs allow into the folder ``out`` and return the files.

    - ``<run>-map``, ``<run>-occupancy``, ``<run>-gap``, ``<run>-similarity``: a run's map with
      trajectory and truth, as points and (in the plane) as an occupancy grid, the model scan that
      each scan used, and the similarity matrix. Of more than 6 runs, the last three only, for one
      rbtm run a data set, which the title names.
    - ``<dataset>-trajectories``: the paths of all methods upon the truth, a panel a backend, from
      2 methods on.
    - ``<dataset>-error_over_path``: the APE of every scan over the true path, where it is known.
    - ``<dataset>-error_over_span``: the error of reference relations over the time between their
      scans, where the log has some.
    - ``<dataset>-accuracy_time``: the error of every method over its time a scan, with the Pareto
      front, from 2 methods on.
    - ``<dataset>-boxes``: the error over seeds, where a method has 4 or more, and not more methods
      than fit a page.
    - ``<dataset>-<backend>[-seedN]-standard_beside_rbtm``: the paper's Fig. 4, for runs that
      differ in the selector alone; of several seeds the lowest, of several settings of rbtm the
      first (not the best: that would be chosen on this very data), and the title says so.
    - ``errors``: the error of every method, from 3 runs on.
    - ``<dataset>-heatmap``: the error of rbtm over threshold and window, or over the first two
      numeric settings that vary, a panel a backend; ``<dataset>-line`` if a single one varies.
      For other selectors ``<dataset>-<selector>-heatmap`` and ``-line``.

    Runs that are not done are left out. Raises ``DataError`` if nothing is left to draw, a file
    is damaged, or ``out`` cannot be written.
    """
    done = [run for run in runs if run.done]
    if not done:
        raise DataError(f"nothing to draw: {_why_none(runs)}")
    written: list[Path] = []
    with style.paper():
        for stem, figure in _figures(list(runs), done):
            written += style.save(figure, out, stem)
    if not written:
        names = ", ".join(labels.folder_name(run) for run in done[:3])
        raise DataError(f"nothing to draw: no map, steps, similarity or error in {names}")
    return written


def _figures(runs: list[Run], done: list[Run]) -> Iterator[Named]:
    """All figures, one at a time: a large map need not wait in memory for the others."""
    stems = labels.stems(done)
    if len(runs) <= MANY:
        for run in done:
            yield from _present(stems[run], "map", maps.single(run))
            yield from _present(stems[run], "occupancy", occupancy.draw(run))
            yield from _of_selection(stems[run], run, note="")
    else:
        for run, note in _representatives(done):
            yield from _present(stems[run], "occupancy", occupancy.draw(run, note))
            yield from _of_selection(stems[run], run, note)
    for pair in standard_and_rbtm(done):
        yield from _present(pair.stem, "standard_beside_rbtm", maps.beside(pair))
    if len(runs) > 2:
        figure = methods.errors(runs)
        if figure is not None:
            yield "errors", figure
    yield from _of_methods(runs)
    for study in studies(runs):
        if len(study.axes) == 1:
            yield f"{study.stem}-line", lines.draw(study)
            continue
        yield from _numbered(f"{study.stem}-heatmap", heatmaps.draw(study))


def _of_methods(runs: list[Run]) -> Iterator[Named]:
    """Figures of all methods side by side, a data set at a time."""
    for data in groups.data_sets(runs):
        yield from _numbered(f"{data.stem}-trajectories", trajectories.draw(data))
        yield from _numbered(f"{data.stem}-error_over_path", growth.draw(data))
        yield from _numbered(f"{data.stem}-error_over_span", spans.draw(data))
        yield from _numbered(f"{data.stem}-accuracy_time", cost.draw(data))
    for stem, figure in boxes.draw(runs):
        yield f"{stem}-boxes", figure


def _numbered(stem: str, figures: Iterable[Figure]) -> Iterator[Named]:
    """The figures with their stems; those after the first have a number."""
    for number, figure in enumerate(figures, start=1):
        yield stem + (f"-{number}" if number > 1 else ""), figure


def _of_selection(stem: str, run: Run, note: str) -> Iterator[Named]:
    """Figures of how a run chose its model scans; a system has no selector and chooses none."""
    if labels.is_system(run):
        return
    yield from _present(stem, "gap", steps.gaps(run, note))
    yield from _present(stem, "similarity", matrix.similarity(run, note))


def _present(stem: str, kind: str, figure: Figure | None) -> Iterator[Named]:
    if figure is not None:
        yield f"{stem}-{kind}", figure


def _representatives(done: list[Run]) -> Iterator[tuple[Run, str]]:
    """One rbtm run a data set with a note for its title: the first with a real backend, of the
    lowest seed."""
    by_data: dict[str, list[Run]] = {}
    for run in done:
        if labels.choice(run, "selector") == "rbtm":
            by_data.setdefault(labels.data_key(run), []).append(run)
    for group in by_data.values():
        real = [run for run in group if labels.choice(run, "backend") != "none"] or group
        chosen = min(real, key=labels.seed_order)
        note = f"run {labels.folder_name(chosen)}"
        if len(group) > 1:
            note += f": the first of {len(group)} rbtm runs"
        yield chosen, note


def _why_none(runs: Sequence[Run]) -> str:
    if not runs:
        return "no runs given"
    first = runs[0]
    status = str(first.record.get("status"))
    reason = first.record.get("reason")
    detail = f"{status}: {reason}" if reason else status
    return f"none of {len(runs)} run(s) is done ({labels.folder_name(first)} is {detail})"
