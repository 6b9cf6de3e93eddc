"""The figures of the RBTM paper, made from our runs: what ``scripts/reproduce_paper.py`` draws.

Maps, matrices and steps of any run are drawn by ``maps``, ``matrix`` and ``steps``; this is what
the paper shows and they do not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch, Patch, Polygon
from matplotlib.path import Path as MplPath
from matplotlib.ticker import MaxNLocator, MultipleLocator

from rbtm_bench.core.types import Array
from rbtm_bench.datasets.environments import Segment
from rbtm_bench.plots import maps, style
from rbtm_bench.plots.folder import Scene, Steps

CM = 100.0
WALL = "0.75"
ROBOT = 8.0
"""Radius of the circle that stands for the robot, cm."""
FIRST: dict[str, Any] = {"color": style.NAVY, "lw": 1.3}
SECOND: dict[str, Any] = {"color": style.VERMILION, "lw": 0.7}
DOT = 0.7
"""Of a map's points, points."""
CHOICES: dict[str, dict[str, Any]] = {
    "chosen": {"color": style.BLACK, "lw": 1.6, "ls": "-"},
    "below": {"color": style.VERMILION, "lw": 1.1, "ls": "--"},
    "not asked": {"color": "0.5", "lw": 0.9, "ls": ":"},
}
"""What became of a candidate: lines that differ in grey as well."""
NEW: dict[str, Any] = {"marker": "o", "mec": style.BLACK, "mew": 1.6, "mfc": "0.85"}
CANDIDATE: dict[str, Any] = {"marker": "o", "mec": style.BLACK, "mew": 0.8, "mfc": "w"}
OUTSIDE: dict[str, Any] = {"marker": "o", "mec": "0.7", "mew": 0.8, "mfc": "w"}


@dataclass(frozen=True, eq=False)
class View:
    """A scan from above, m in the world: the sensor's pose (4, 4), the returns ``points`` (N, 2),
    and the ends of all beams ``ends`` (B, 2), those without a return at the greatest range."""

    name: str
    pose: Array
    points: Array
    ends: Array


@dataclass(frozen=True)
class DescriptorPair:
    """Descriptors (B,) in rad of two scans, NaN where undefined, and their similarity."""

    title: str
    phi: tuple[Array, Array]
    score: float


@dataclass(frozen=True)
class Tried:
    """A candidate of a new scan: its similarity, and what became of it ("chosen", "below" or
    "not asked")."""

    model: int
    score: float
    outcome: str


def outline(walls: Sequence[Segment]) -> Array:
    """The corners (W, 2) of the room that the wall segments enclose, one after the other.

    Raises ``ValueError`` if the first segment is not part of a closed line of all of them.
    """
    rest = [tuple(segment) for segment in walls[1:]]
    corners = list(walls[0])
    while rest:
        following = next((segment for segment in rest if corners[-1] in segment), None)
        if following is None:
            raise ValueError(f"the walls end at {corners[-1]}")
        rest.remove(following)
        corners.append(following[1] if following[0] == corners[-1] else following[0])
    if corners[0] != corners[-1]:
        raise ValueError(f"the walls do not close: {corners[0]} and {corners[-1]}")
    return np.array(corners[:-1])


def descriptors(room: Array, views: tuple[View, View], pairs: Sequence[DescriptorPair]) -> Figure:
    """The paper's Fig. 1(b): a simple environment with two scans, beside it their descriptors
    over the beam, a strip each, for every pair."""
    figure = Figure(figsize=(style.DOUBLE, 3.6))
    grid = figure.add_gridspec(2 * len(pairs), 2, width_ratios=(1.0, 1.0))
    for half, view, look in zip((0, 1), views, (FIRST, SECOND), strict=True):
        ax = figure.add_subplot(grid[half * len(pairs) : (half + 1) * len(pairs), 0])
        _one_scan(ax, room, view, look)
        ax.set_title(f"({'ab'[half]}) {view.name}")
        ax.label_outer()
    strips: list[Axes] = []
    for row, pair in enumerate(pairs):
        for number, (phi, look) in enumerate(zip(pair.phi, (FIRST, SECOND), strict=True)):
            strip = figure.add_subplot(
                grid[2 * row + number, 1], sharex=strips[0] if strips else None
            )
            strip.plot(np.arange(2, len(phi) + 2), np.degrees(phi), **look)
            strip.set(ylim=(-100, 100), yticks=(-90, 0, 90))
            strip.set_ylabel(f"scan {'jk'[number]}\n$\\phi$ (deg)")
            _no_return(strip, phi)
            if number == 0:
                letter = "cdef"[row]
                strip.set_title(f"({letter}) {pair.title}: similarity S = {pair.score:.2f}")
            strips.append(strip)
    for strip in strips[:-1]:
        strip.tick_params(labelbottom=False)
    strips[-1].set_xlabel("beam index i")
    strips[-1].set_xlim(0, len(pairs[0].phi[0]) + 3)
    return figure


def _one_scan(ax: Axes, room: Array, view: View, look: dict[str, Any]) -> None:
    _room(ax, room, edge="0.5")
    ax.plot(*(CM * view.points.T), ls="", marker=".", ms=3.5, mew=0, color=look["color"])
    _robot(ax, view.pose, look["color"])


def _no_return(ax: Axes, phi: Array) -> None:
    """Say why nothing is drawn where the longest run of beams has no descriptor."""
    empty = np.flatnonzero(np.isnan(phi))
    if not len(empty):
        return
    run = max(np.split(empty, np.flatnonzero(np.diff(empty) > 1) + 1), key=len)
    if len(run) > 0.08 * len(phi):
        ax.text(
            run.mean() + 2, 0.0, "no\nreturn", ha="center", va="center", fontsize=style.font() - 2
        )


def _room(ax: Axes, room: Array, edge: str = style.BLACK) -> None:
    """Free space white, walls grey, and cm, as in the paper."""
    low, high = CM * room.min(axis=0) - 15, CM * room.max(axis=0) + 15
    ax.set_facecolor(WALL)
    ax.add_patch(Polygon(CM * room, fc="w", ec=edge, lw=0.6, zorder=0))
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x (cm)", ylabel="y (cm)")
    ax.set_aspect("equal", adjustable="box")


def _robot(ax: Axes, pose: Array, colour: str) -> None:
    """A circle with a line in the direction of the heading."""
    turn = np.linspace(0.0, 2.0 * np.pi, 41)
    x, y = CM * pose[:2, 3]
    tip = ROBOT * pose[:2, 0]
    circle = np.column_stack([x + ROBOT * np.cos(turn), y + ROBOT * np.sin(turn)])
    ax.add_patch(Polygon(circle, fc="w", ec=colour, lw=1.0, zorder=6))
    ax.plot((x, x + tip[0]), (y, y + tip[1]), color=colour, lw=1.0, zorder=7)


def matrices(panels: Sequence[tuple[str, tuple[Array, Array]]]) -> Figure:
    """The paper's Fig. 1(c): similarity matrices beside each other on one scale.

    ``panels`` are titles with scan numbers (K,), from 0, and scores (K, K).
    """
    figure = Figure(figsize=(style.DOUBLE, 2.9))
    axes = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    lowest = min(float(np.nanmin(scores)) for _, (_, scores) in panels)
    bottom = min(0.0, math.floor(10 * lowest) / 10)
    for ax, (title, (scans, scores)) in zip(axes, panels, strict=True):
        edge = (float(scans[0]) + 0.5, float(scans[-1]) + 1.5)
        image = ax.imshow(
            scores, extent=(*edge, *edge[::-1]), vmin=bottom, vmax=1.0, cmap="viridis",
            interpolation="nearest",
        )  # fmt: skip
        others = scores[~np.eye(len(scores), dtype=bool)]
        ax.set_title(f"{title}\nlargest off the diagonal: {np.nanmax(others):.2f}")
        ax.set_xlabel("scan k")
        ax.xaxis.set_major_locator(MaxNLocator(4, integer=True))
        ax.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    axes[0].set_ylabel("scan j")
    beside = axes[-1].inset_axes((1.05, 0.0, 0.06, 1.0))  # as high as a matrix
    figure.colorbar(image, cax=beside, label="similarity S")
    style.fit_height(figure, [axes[0]], tallest=style.SINGLE)
    return figure


def model_choice(
    example: Sequence[tuple[int, Sequence[Tried]]],
    title: str,
    steps: Steps,
    steps_title: str,
) -> Figure:
    """The paper's Fig. 2: the choice of the model scan, step by step on a few scans, and below
    it over a whole run.

    ``example`` has for every new scan its candidates, oldest first. Scans count from 1.
    """
    figure = Figure(figsize=(style.DOUBLE, 5.2))
    above, below = figure.subplots(2, 1, height_ratios=(1.6, 1.0))
    for row, (scan, tried) in enumerate(example):
        _step(above, -float(row), scan, tried)
    last = max(scan for scan, _ in example)
    above.set(xlim=(0.3, last + 0.3), ylim=(0.4 - len(example), 0.75), yticks=[], xticks=[])
    above.spines[:].set_visible(False)
    above.set_title(style.wrapped(f"(a) {title}", style.DOUBLE))
    words = ("S > Th: the model scan", "S \N{LESS-THAN OR EQUAL TO} Th: not matched", "not asked")
    handles = [
        Line2D([], [], **look, label=word)
        for look, word in zip(CHOICES.values(), words, strict=True)
    ]
    dots = (("new scan", NEW), ("outside the window", OUTSIDE))
    handles += [Line2D([], [], ls="", ms=8, label=word, **look) for word, look in dots]
    above.legend(handles=handles, loc="upper right")
    _models(below, steps)
    below.set_title(style.wrapped(f"(b) {steps_title}", style.DOUBLE))
    return figure


def _step(ax: Axes, y: float, scan: int, tried: Sequence[Tried]) -> None:
    """A row: the scans so far as circles, an arc from the new one to each candidate, and below
    the candidate its similarity."""
    candidates = {one.model: one for one in tried}
    for number in range(1, scan + 1):
        inside = number in candidates or number == scan
        look = NEW if number == scan else CANDIDATE if inside else OUTSIDE
        ax.plot(number, y, ms=13, zorder=3, **look)
        colour = style.BLACK if inside else "0.6"
        ax.text(number, y, str(number), ha="center", va="center_baseline", color=colour, zorder=4)
    for one in tried:
        look = CHOICES[one.outcome]
        height = 0.16 + 0.26 * (scan - one.model)
        arc = MplPath(
            [(scan, y + 0.16), (scan, y + height), (one.model, y + height), (one.model, y + 0.18)],
            [MplPath.MOVETO, MplPath.CURVE4, MplPath.CURVE4, MplPath.CURVE4],
        )
        ax.add_patch(
            FancyArrowPatch(path=arc, arrowstyle="-|>", mutation_scale=8, zorder=2, **look)
        )
        if one.outcome != "not asked":
            ax.text(
                one.model, y - 0.22, f"S = {one.score:.2f}", ha="center", va="top",
                color=look["color"], weight="bold" if one.outcome == "chosen" else "normal",
            )  # fmt: skip
    ax.text(0.75, y, f"step {scan}", ha="right", va="center_baseline")


def _models(ax: Axes, steps: Steps) -> None:
    """The model scan over the scan, and what the standard way takes; fallbacks apart."""
    scan, model = steps.scan + 1, steps.scan - steps.gap + 1
    ax.plot(scan, scan - 1, color="0.5", lw=0.9, ls="--", label="standard: the previous scan")
    looks: tuple[tuple[str, str, dict[str, Any]], ...] = (
        ("registered", "RBTM: S > Th", {"marker": ".", "color": style.BLACK, "ms": 3.5}),
        ("fallback", "RBTM: fallback", {"marker": "^", "color": style.VERMILION, "ms": 4.0}),
    )
    for status, word, look in looks:
        chosen = np.isfinite(model) & (steps.status == status)
        if chosen.any():
            label = f"{word} ({int(chosen.sum())} scans)"
            ax.plot(scan[chosen], model[chosen], ls="", label=label, **look)
    ax.set(xlabel="scan j", ylabel="model scan m", xlim=(0, len(scan) + 1), ylim=(0, None))
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(6, integer=True))
    ax.legend(loc="upper left")


def environment(room: Array, view: View, end: Array, path: Array, title: str) -> Figure:
    """The paper's Fig. 3: the place from above in cm, the drive, and what the sensor sees from
    its start. ``view.points`` are in the order of sensing, ``path`` (N, 2) m."""
    figure = Figure(figsize=(style.SINGLE, 2.6))
    ax = figure.add_subplot()
    _room(ax, room)
    seen = CM * np.vstack([view.pose[:2, 3], view.ends])
    ax.add_patch(Polygon(seen, fc=style.SKY, alpha=0.3, ec="none", zorder=1))
    dots: dict[str, Any] = {"ls": "", "marker": "o", "mew": 0, "color": style.BLUE}
    ax.plot(*(CM * view.points.T), ms=0.9, zorder=3, **dots)
    ax.plot(*(CM * path.T), color=style.BLACK, lw=1.0, ls="--", zorder=4)
    for pose in (view.pose, end):
        _robot(ax, pose, style.BLACK)
    _sizes(ax, CM * room, CM * path)
    handles = [
        Patch(fc=WALL, ec=style.BLACK, lw=0.8, label="walls"),
        Patch(fc=style.SKY, alpha=0.3, label="seen from the start"),
        Line2D([], [], ms=2.0, label="points of that scan", **dots),
        Line2D([], [], color=style.BLACK, lw=1.0, ls="--", label="path, start left"),
    ]
    ax.yaxis.set_major_locator(MultipleLocator(100))
    style.title(figure, title, style.SINGLE)
    style.legend_below(figure, handles, columns=2)
    style.fit_height(figure, [ax], tallest=5.0)
    return figure


def _sizes(ax: Axes, room: Array, path: Array) -> None:
    """Dimensions as arrows: the pieces of both walls, the recesses' depths, the width, the path."""
    heights = np.unique(room[:, 1])
    wall = {True: float(heights[heights > 0].min()), False: float(heights[heights < 0].max())}
    for top, y in wall.items():
        side = room[(room[:, 1] > 0) == top]
        for x0, x1 in pairwise(np.unique(side[:, 0])):
            _size(ax, (x0, 0.62 * y), (x1, 0.62 * y), x1 - x0)
            deep = [corner for corner in side if abs(corner[1]) > abs(y) and corner[0] in (x0, x1)]
            if len(deep) == 2 and x1 - x0 < 80:
                back = float(deep[0][1])
                _size(ax, (0.5 * (x0 + x1), y), (0.5 * (x0 + x1), back), abs(back - y))
    left = float(room[:, 0].min()) + 18
    _size(ax, (left, wall[False]), (left, wall[True]), wall[True] - wall[False])
    (x0, y0), (x1, _) = path[0], path[-1]
    _size(ax, (x0, y0 - 42), (x1, y0 - 42), x1 - x0)


def _size(ax: Axes, start: tuple[float, float], end: tuple[float, float], size: float) -> None:
    """An arrow between two points, along an axis, with its length (cm) beside it."""
    look = {"arrowstyle": "<->", "lw": 0.5, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 5}
    ax.annotate("", start, end, arrowprops=look, zorder=5)
    (x0, y0), (x1, y1) = start, end
    level = y0 == y1
    ax.text(
        0.5 * (x0 + x1) + (0 if level else 5), 0.5 * (y0 + y1), f"{size:.0f}", zorder=5,
        ha="center" if level else "left", va="bottom" if level else "center",
        fontsize=style.font() - 2,
    )  # fmt: skip


def map_figure(scene: Scene, limits: maps.Limits, title: str) -> Figure:
    """The paper's Fig. 4(a) or (b): a map with estimated and true trajectory. ``limits`` are for
    both, so that they can be laid beside each other."""
    figure = Figure(figsize=(style.SINGLE, style.SINGLE))
    ax = figure.add_subplot()
    handles = maps.panel(ax, scene, limits, DOT)
    style.title(figure, title, style.SINGLE)
    style.legend_below(figure, handles, columns=2)
    style.fit_height(figure, [ax], tallest=4.0)
    return figure
