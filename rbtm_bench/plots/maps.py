"""Maps with the estimated trajectory and the truth: of one run, or standard beside RBTM."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MultipleLocator

from rbtm_bench.plots import labels, style
from rbtm_bench.plots.folder import Scene, read_scene
from rbtm_bench.plots.pairs import Pair
from rbtm_bench.results import Run

Limits = tuple[float, float, float, float]
"""x from, x to, y from, y to, in m."""

SMALLEST_DOT = 0.4
LARGEST_DOT = 1.5
"""Points."""
TRIMMED = 0.2
"""Percent of the points at each side that may lie outside, where they would double the view."""
WIDE = 0.45
"""Height over width of a map below which two are stacked instead of side by side."""


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
    figure.suptitle(style.wrapped(text, style.SINGLE))
    style.legend_below(figure, handles, columns=2)
    style.fit_height(figure, [ax], tallest=5.0)
    return figure


def beside(pair: Pair) -> Figure | None:
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
    words = [labels.data_name(run), labels.choice(run, "backend"), *labels.seed_words(run)]
    figure.suptitle(", ".join(words))
    style.legend_below(figure, handles, columns=4)
    style.fit_height(figure, list(axes[:, 0]), tallest=5.0)
    return figure


def _panel_titles(pair: Pair) -> tuple[str, str]:
    remarks = [f", {words}" if words else "" for words in pair.remarks]
    chosen = f", the first of {pair.settings} settings" if pair.settings > 1 else ""
    return (
        f"(a) standard: {labels.method(pair.standard)}{remarks[0]}\n{final_error(pair.standard)}",
        f"(b) {labels.method(pair.rbtm)}{chosen}{remarks[1]}\n{final_error(pair.rbtm)}",
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
    text = f"final error {labels.quantity(total, 'mm')}"
    if heading is not None:
        text += f", heading {labels.quantity(heading, 'deg')}"
    if along is not None and cross is not None:
        text += f"\nalong {labels.quantity(along, 'mm')}, cross {labels.quantity(cross, 'mm')}"
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
    pad = max(0.04 * max(high - low for low, high in spans), 0.05)
    for low, high in spans:
        out += [low - pad, high + pad]
    return out[0], out[1], out[2], out[3]


def _span(values: np.ndarray) -> tuple[float, float]:
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
    look: dict[str, Any] = {"ls": "", "marker": "o", "color": style.BLACK, "mew": 0}
    ax.plot(x, y, **look, ms=dot, rasterized=many, zorder=1)
    handles = [Line2D([], [], **look, ms=2.0, label=_map_label(float(outside)))]
    handles += ax.plot(
        *scene.path.T, "-", color=style.VERMILION, lw=2.0, label="estimated poses",
        marker="s", ms=4.5, markevery=[len(scene.path) - 1], solid_capstyle="round", zorder=3,
    )  # fmt: skip
    if scene.truth is not None:
        handles += ax.plot(
            *scene.truth.T, color=style.BLACK, lw=0.9, ls=(0, (3, 2)), label="ground truth",
            marker="o", ms=6.5, mfc="none", markevery=[len(scene.truth) - 1], zorder=4,
        )  # fmt: skip
    handles += ax.plot(
        *scene.path[0], "^", color="w", mec=style.BLACK, mew=0.9, ms=5.5, label="start", zorder=5
    )
    ax.set(xlim=(x0, x1), ylim=(y0, y1), xlabel="x (m)", ylabel="y (m)")
    ax.set_aspect("equal", adjustable="box")
    step = _step(max(x1 - x0, y1 - y0) / 4)
    for side in (ax.xaxis, ax.yaxis):
        side.set_major_locator(MultipleLocator(step))
    return handles


def _step(about: float) -> float:
    """The largest of 1, 2, 5, 10, ... up to ``about``: the same for both axes of a map."""
    power = 10.0 ** np.floor(np.log10(about))
    return float(max(f * power for f in (1, 2, 5) if f * power <= about * (1 + 1e-9)))


def _map_label(outside: float) -> str:
    return "map" if outside == 0 else f"map ({outside:.1%} of it outside)"
