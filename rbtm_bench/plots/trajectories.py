"""The paths of all methods on a data set, a panel a backend, upon the true path."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array
from rbtm_bench.plots import groups, labels, panels, style
from rbtm_bench.plots.folder import read_paths
from rbtm_bench.plots.groups import Data, Panel
from rbtm_bench.plots.looks import GUESS, TRUTH, Look, looks
from rbtm_bench.plots.maps import START, Limits
from rbtm_bench.runs.stored import Run

COLUMNS = 3
TALL = 3.0
"""Height of a panel at most, inches."""
LOST = 2.0
"""A path that goes this many times as far from the start as the truth (or as the median path)
does not widen the view, and ends where it leaves it."""
FLAT = 0.2
"""Height over width that a view has at least."""
LEVEL = 1e-6
"""m that a path may leave its first plane and still count as planar."""
END: dict[str, Any] = {"marker": "o", "ms": 9.0, "mfc": "none", "mec": "0.55", "mew": 1.2}
"""Of the true last position."""


@dataclass(frozen=True, eq=False)
class Lines:
    """Positions (N, 3) m of every (panel, method) relative to the first pose; of the truth and of
    the guess alone, None without."""

    paths: dict[tuple[str, str], Array]
    truth: Array | None
    guess: Array | None

    @property
    def planar(self) -> bool:
        return all(np.abs(path[:, 2]).max() <= LEVEL for path in self.paths.values())


def draw(data: Data) -> Iterator[Figure]:
    """The paths of the lowest seed that all methods have, first poses made equal; nothing for a
    single method or without trajectories."""
    few, note = data.few()
    seeds = _common_seeds(few)
    lines = _read(few, min(seeds, default=None)) if data.several else None
    if lines is None:
        return
    view = limits(lines)
    own, colours = looks(few.methods), few.colours

    def panel(ax: Axes, panel: Panel) -> None:
        tinted = {name: look.of(colours[panel.name]) for name, look in own.items()}
        _draw_panel(ax, panel, lines, tinted, view)
        ax.set(xlim=view[:2], ylim=view[2:], xlabel="x (m)", ylabel="y (m)")
        ax.set_aspect("equal", adjustable="box")
        for side in (ax.xaxis, ax.yaxis):
            side.set_major_locator(MaxNLocator(4))

    seen = "paths" if lines.planar else "paths from above"
    words = [f"{data.name}: {seen}, first poses made equal"]
    if seeds and any(len(method.runs) > 1 for p in few.panels for method in p.methods):
        has_seeds = groups.repeats(data.runs) == "seeds"
        words.append(labels.unbroken(f"seed {min(seeds):g}" if has_seeds else "data as they are"))
    title = ", ".join([*words, note] if note else words)
    yield from panels.pages(
        few.panels, COLUMNS, TALL, panel, title, _handles(own, lines), equal=True
    )


def limits(lines: Lines) -> Limits:
    """A view that holds the truth and every path that is not lost."""
    reach = [float(np.abs(path[:, :2]).max()) for path in lines.paths.values()]
    usual = np.median(reach) if lines.truth is None else np.abs(lines.truth).max()
    paths = [*lines.paths.values(), *([] if lines.guess is None else [lines.guess])]
    kept = [path for path in paths if np.abs(path[:, :2]).max() <= LOST * usual]
    points = np.concatenate([*kept, *([] if lines.truth is None else [lines.truth])])[:, :2]
    low, high = points.min(axis=0), points.max(axis=0)
    width, height = np.maximum(high - low, 1e-3 * max(*(high - low), 1e-3))
    pad = 0.08 * max(width, height)
    pads = np.array([pad, max(pad, 0.5 * (FLAT * width - height))])
    (x0, y0), (x1, y1) = low - pads, high + pads
    return float(x0), float(x1), float(y0), float(y1)


def _draw_panel(ax: Axes, panel: Panel, lines: Lines, own: dict[str, Look], view: Limits) -> None:
    if lines.truth is not None:
        ax.plot(*lines.truth[:, :2].T, **TRUTH, zorder=1)
        ax.plot(*lines.truth[-1, :2], **END, ls="", zorder=2)
    if lines.guess is not None:
        ax.plot(*lines.guess[:, :2].T, **GUESS, zorder=2)
    outside = []
    for level, method in enumerate(panel.methods):
        path = lines.paths.get((panel.name, method.name))
        if path is None:
            continue
        left = np.flatnonzero(~_inside(path, view))
        shown, end = (path[: left[0] + 1], left[0] - 1) if len(left) else (path, -1)
        # the wide line of rbtm below the thin ones, what got lost below all
        look, depth = own[method.name], (0 if len(left) else len(panel.methods) - level)
        line = {**look.line, "lw": (0.5 if len(left) else 1.0) * look.width}
        ax.plot(*shown[:, :2].T, **line, label=method.name, zorder=3 + depth)
        ax.plot(*path[end, :2], **look.mark, ls="", zorder=12 + depth)
        outside += [style.names().of("selector", method.selector)] if len(left) else []
    ax.plot(0.0, 0.0, **START, zorder=30)
    if outside:
        ax.text(
            0.02, 0.02, f"leave the view: {', '.join(outside)}", transform=ax.transAxes,
            fontsize=0.8 * style.font(), c="0.25", zorder=31,
            bbox={"fc": "w", "ec": "none", "alpha": 0.7, "pad": 1.0},
        )  # fmt: skip


def _inside(path: Array, view: Limits) -> NDArray[np.bool_]:
    x, y = path[:, 0], path[:, 1]
    return np.asarray((view[0] <= x) & (x <= view[1]) & (view[2] <= y) & (y <= view[3]))


def _handles(own: dict[str, Look], lines: Lines) -> list[Any]:
    handles = [panels.handle(name, **look.line, **look.mark) for name, look in own.items()]
    if lines.truth is not None:
        end = {**END, "ms": 7.0}
        handles.append(panels.handle("ground truth", **TRUTH, **end))
    if lines.guess is not None:
        handles.append(panels.handle(labels.member("backend", "none"), **GUESS))
    return [*handles, panels.handle("start", **START)]


def _common_seeds(data: Data) -> set[float]:
    """The seeds that every method has a run of."""
    seeds = [
        {float(run.record["seed"]) for run in method.runs if run.record.get("seed") is not None}
        for panel in data.panels
        for method in panel.methods
    ]
    return set.intersection(*seeds)


def _read(data: Data, seed: float | None) -> Lines | None:
    paths: dict[tuple[str, str], Array] = {}
    truth = None
    for panel in data.panels:
        for method in panel.methods:
            chosen = [run for run in method.runs if labels.seed_order(run) == seed]
            run_paths = read_paths((chosen or method.runs)[0])
            if run_paths is not None:
                paths[panel.name, method.name] = _positions(run_paths.estimate.T_world_scan)
                if truth is None and run_paths.truth is not None:
                    truth = _positions(run_paths.truth.T_world_scan)
    guess = _guess(data.guess)
    return Lines(paths, truth, guess) if paths else None


def _guess(run: Run | None) -> Array | None:
    paths = read_paths(run) if run is not None else None
    return None if paths is None else _positions(paths.estimate.T_world_scan)


def _positions(T: Array) -> Array:
    """Positions (N, 3) relative to the first pose."""
    return np.asarray((inverse(T[0]) @ T)[:, :3, 3])
