"""Maps with the estimated trajectory and the truth: of one run, or standard beside RBTM."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MultipleLocator

from rbtm_bench.core.types import Array
from rbtm_bench.plots import labels, style
from rbtm_bench.plots.folder import Scene, read_scene
from rbtm_bench.plots.pairs import RunPair
from rbtm_bench.runs.stored import Run

Limits = tuple[float, float, float, float]
"""x from, x to, y from, y to, in m."""

SMALLEST_DOT = 0.4
LARGEST_DOT = 1.5
"""Points."""
TRIMMED = 0.2
"""Percent of the points at each side that may lie outside, where they would double the view."""
SHADE = 0.15
"""Darkness of a dot in a 3D map from above: walls, many points high, come out of the ground."""
NARROW = 0.2
"""Least share of the longer side that the shorter one gets."""
WIDE = 0.45
"""Height over width of a map below which two are stacked instead of side by side."""

ESTIMATED: dict[str, Any] = {
    **{"color": style.VERMILION, "lw": 1.6},
    **{"marker": "s", "mec": style.BLACK, "mew": 0.6, "ms": 4.0},
}
TRUE: dict[str, Any] = {
    **{"color": style.NAVY, "lw": 1.1, "ls": (0, (3, 1.5))},
    **{"marker": "o", "mfc": "w", "mec": style.NAVY, "mew": 1.1, "ms": 7.0},
}
START: dict[str, Any] = {
    "ls": "", "marker": "^", "mfc": "w", "mec": style.BLACK, "mew": 0.9, "ms": 5.5
}  # fmt: skip
"""Solid and dashed, full and hollow: they differ in grey as well."""


def single(run: Run) -> Figure | None:
    """A run's map; None without the files for it."""
    scene = read_scene(run)
    if scene is None:
        return None
    limits = view([scene])
    figure = Figure(figsize=(style.SINGLE, style.SINGLE))
    ax = figure.add_subplot()
    handles = panel(ax, scene, limits, _dot(run, limits, style.SINGLE))
    text = f"{labels.title(run)}\n{labels.error_words(run)}".strip()
    style.title(figure, text, style.SINGLE)
    style.legend_below(figure, handles, columns=2)
    style.fit_height(figure, [ax], tallest=5.0)
    return figure


def beside(pair: RunPair) -> Figure | None:
    """The paper's Fig. 4: standard and RBTM in the same limits; None without their files."""
    scenes = [read_scene(run) for run in (pair.standard, pair.rbtm)]
    shown = [scene for scene in scenes if scene is not None]
    if len(shown) < 2:
        return None
    limits = view(shown)
    ratio = (limits[3] - limits[2]) / (limits[1] - limits[0])
    stacked = ratio < WIDE
    width = style.DOUBLE if stacked else style.DOUBLE / 2
    figure = Figure(figsize=(style.DOUBLE, style.DOUBLE))
    shape = (2, 1) if stacked else (1, 2)
    axes = figure.subplots(*shape, sharex=True, sharey=True, squeeze=False)
    dot = _dot(pair.rbtm, limits, width)
    for ax, scene, text in zip(axes.ravel(), shown, _panel_titles(pair), strict=True):
        handles = panel(ax, scene, limits, dot)
        ax.set_title(style.wrapped(text, width))
        ax.label_outer()
    run = pair.rbtm
    words = [style.names().data_of(run), labels.word(run, "backend"), *labels.seed_words(run)]
    style.title(figure, ", ".join(words), style.DOUBLE)
    style.legend_below(figure, handles, columns=4)
    style.fit_height(figure, list(axes[:, 0]), tallest=5.0)
    return figure


def _panel_titles(pair: RunPair) -> tuple[str, str]:
    remarks = [f", {words}" if words else "" for words in pair.remarks]
    return (
        f"(a) {labels.method(pair.standard)}{remarks[0]}\n{final_error(pair.standard)}",
        f"(b) {labels.method(pair.rbtm)}{remarks[1]}\n{final_error(pair.rbtm)}",
    )


def final_error(run: Run) -> str:
    """The final error with its parts, or the run's main error where no truth is known."""
    total = labels.value(run, "final_translation_error_mm")
    if total is None:
        return labels.error_words(run) or "no error known"
    along, cross, heading = (
        labels.value(run, key)
        for key in ("final_along_mm", "final_cross_mm", "final_heading_error_deg")
    )
    unit, per = ("m", 1e-3) if total >= labels.LARGE else ("mm", 1.0)
    text = f"final error {labels.quantity(per * total, unit)}"
    if heading is not None:
        text += f", heading {labels.quantity(heading, 'deg')}"
    if along is not None and cross is not None:
        parts = (labels.quantity(per * along, unit), labels.quantity(per * cross, unit))
        text += f"\nalong {parts[0]}, cross {parts[1]}"
    return text


def view(scenes: Sequence[Scene]) -> Limits:
    """Limits that hold every pose and the maps' points.

    A few stray returns do not decide: where the outermost 0.2 % of the points at each side would
    double the view, they lie outside.
    """
    out: list[float] = []
    spans = []
    for axis in (0, 1):
        points = np.concatenate([scene.points[:, axis] for scene in scenes])
        poses = [s.path[:, axis] for s in scenes]
        poses += [s.truth[:, axis] for s in scenes if s.truth is not None]
        fixed = np.concatenate(poses)
        full = _span(np.concatenate([points, fixed]))
        inner = np.percentile(points, [TRIMMED, 100 - TRIMMED]) if len(points) else fixed[:1]
        core = _span(np.concatenate([inner, fixed]))
        spans.append(core if np.diff(full) > 2 * np.diff(core) else full)
    longest = max(high - low for low, high in spans)
    for low, high in spans:
        pad = max(0.04 * longest, (NARROW * longest - (high - low)) / 2, 0.05)
        out += [low - pad, high + pad]
    return out[0], out[1], out[2], out[3]


def _span(values: Array) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _dot(run: Run, limits: Limits, width: float) -> float:
    """Size of a map's dots, points: that of the map's cells where it is fit to be seen."""
    cell = run.config.get("map_resolution")
    if not isinstance(cell, int | float):
        return SMALLEST_DOT
    scale = 72 * (width - 0.6) / (limits[1] - limits[0])
    return min(max(0.7 * cell * scale, SMALLEST_DOT), LARGEST_DOT)


def panel(ax: Axes, scene: Scene, limits: Limits, dot: float) -> list[Line2D]:
    """Draw a map into the axes and return what its legend holds. ``dot`` is in points."""
    x0, x1, y0, y1 = limits
    x, y = scene.points.T
    many = len(scene.points) >= style.RASTER_FROM
    outside = np.mean((x < x0) | (x > x1) | (y < y0) | (y > y1)) if len(x) else 0.0
    dots: dict[str, Any] = {"ls": "", "marker": "o", "color": style.BLACK, "mew": 0}
    shade = 1.0 if scene.planar else SHADE
    ax.plot(x, y, **dots, ms=dot, alpha=shade, rasterized=many, zorder=1)
    handles = [Line2D([], [], **dots, ms=2.0, label=_map_label(scene, float(outside)))]
    handles += trajectories(ax, scene)
    frame(ax, limits)
    return handles


def trajectories(ax: Axes, scene: Scene, width: float = 1.0, band: bool = True) -> list[Line2D]:
    """Draw the estimated and the true path and the start, and return what a legend holds.
    ``width`` is a factor to the lines'; ``band`` is a white one below each."""
    handles = []
    paths = [("estimated poses", scene.path, ESTIMATED), ("ground truth", scene.truth, TRUE)]
    for level, (name, path, look) in enumerate(paths, start=3):
        if path is None:
            continue
        thin = {**look, "lw": width * look["lw"]}
        line = {key: value for key, value in thin.items() if not key.startswith("m")}
        if band:  # hides map dots, but no other trajectory
            ax.plot(*path.T, color="w", lw=3.0, solid_capstyle="round", zorder=2)
        ax.plot(*path.T, **line, zorder=level)
        ax.plot(*path[-1], **{**look, "ls": ""}, zorder=10 - level)
        handles.append(Line2D([], [], **thin, label=name))
    handles += ax.plot(*scene.path[0], **START, label="start", zorder=5)
    return handles


def frame(ax: Axes, limits: Limits) -> None:
    """The axes of a map."""
    x0, x1, y0, y1 = limits
    ax.set(xlim=(x0, x1), ylim=(y0, y1), xlabel="x (m)", ylabel="y (m)")
    ax.set_aspect("equal", adjustable="box")
    step = _nice(max(x1 - x0, y1 - y0) / 6)
    for side, span in ((ax.xaxis, x1 - x0), (ax.yaxis, y1 - y0)):
        # the same step on both sides, unless one is too short for two of them
        side.set_major_locator(MultipleLocator(step if span > 2 * step else _nice(span / 4)))


def _nice(about: float) -> float:
    """The smallest of 1, 2, 5, 10, ... from ``about`` on."""
    power = 10.0 ** np.floor(np.log10(about))
    return float(min(f * power for f in (1, 2, 5, 10) if f * power >= about * (1 - 1e-9)))


def _map_label(scene: Scene, outside: float) -> str:
    view = "map" if scene.planar else "map from above"
    return view if outside == 0 else f"{view} ({outside:.1%} of it outside)"
