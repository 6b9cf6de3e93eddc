"""The scores of a data set as a picture: the matrix of all pairs, or a band of gaps."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import MaxNLocator

from rbtm_bench.plots import style
from rbtm_bench.plots.matrix import UNDEFINED
from rbtm_bench.similarity.scorematrix import Scores

DRAWN = 1000
"""Scans on a side that are drawn; more than a page has room for."""
GAPS_DRAWN = 400
COLOURS = "viridis"
"""Its lightness rises with the value, so that it reads in grey as well."""


def draw(all_scores: Scores, dataset: str, similarity: str) -> Figure:
    """The matrix (the paper's Fig. 1c), or the band with gaps upwards. Undefined scores and pairs
    that do not exist are hatched; axes count scans and, where known, metres travelled."""
    matrix = all_scores.window is None
    count, columns = all_scores.scores.shape
    every = -(-count // DRAWN)
    across = every if matrix else -(-columns // GAPS_DRAWN)
    shown = all_scores.scores[::every, ::across]
    image_of = shown if matrix else shown.T
    width = style.SINGLE + 0.6 if matrix else style.DOUBLE
    figure = Figure(figsize=(width, style.SINGLE if matrix else 2.9))
    ax = figure.add_subplot()
    right = -0.5 + every * len(shown)
    extent = (
        (-0.5, right, right, -0.5) if matrix else (-0.5, right, 0.5, 0.5 + across * shown.shape[1])
    )
    left, end, low, high = extent[0], extent[1], min(extent[2:]), max(extent[2:])
    ax.add_patch(Rectangle((left, low), end - left, high - low, **UNDEFINED, zorder=0))
    finite = shown[np.isfinite(shown)]
    bottom = min(0.0, math.floor(10 * float(finite.min())) / 10) if len(finite) else 0.0
    image = ax.imshow(
        np.ma.masked_invalid(image_of), extent=extent, vmin=bottom, vmax=1.0, cmap=COLOURS,
        interpolation="nearest", origin="upper" if matrix else "lower", zorder=1,
        aspect="equal" if matrix else "auto",
    )  # fmt: skip
    ax.set(
        xlabel="scan k (model)" if matrix else "scan j",
        ylabel="scan j" if matrix else "gap (scans)",
    )
    for side in (ax.xaxis, ax.yaxis):
        side.set_major_locator(MaxNLocator(5, integer=True))
    _metres(ax, all_scores)
    beside = ax.inset_axes((1.05, 0.0, 0.05, 1.0) if matrix else (1.02, 0.0, 0.02, 1.0))
    figure.colorbar(image, cax=beside, label="similarity S")
    handles = []
    if np.isnan(shown).any():
        share = all_scores.undefined_share
        percent = f"{share:.1%}" if share >= 0.001 else "< 0.1%"
        label = f"undefined ({percent})" if share else "no such scan"
        if not matrix and share:
            label += ", or no such scan"
        handles.append(Patch(**UNDEFINED, label=label))
    figure.suptitle(
        style.wrapped("\n".join(_title(all_scores, dataset, similarity, every, across)), width)
    )
    style.legend_below(figure, handles, 1)
    if matrix:
        style.fit_height(figure, [ax], tallest=style.SINGLE)
    return figure


def _title(all_scores: Scores, dataset: str, similarity: str, every: int, across: int) -> list[str]:
    count = len(all_scores.scores)
    lines = [f"{dataset}, {count} scans, similarity {similarity}"]
    thin = []
    if every > 1:
        thin.append(f"one scan in {every} is drawn")
    if all_scores.window is not None and across > 1:
        thin.append(f"one gap in {across} is drawn")
    return [*lines, ", ".join(thin)] if thin else lines


def _metres(ax: Axes, all_scores: Scores) -> None:
    """Metres travelled along the upper side, at the scans that they belong to."""
    if all_scores.metres is None or len(all_scores.metres) < 2 or all_scores.metres[-1] <= 0:
        return
    metres = all_scores.metres
    wanted = np.asarray(MaxNLocator(5).tick_values(0.0, float(metres[-1])))
    wanted = wanted[(wanted >= 0) & (wanted <= metres[-1])]
    # of a robot that stands still the first scan at that place
    upper = ax.secondary_xaxis("top")
    upper.set_xticks(np.searchsorted(metres, wanted), [f"{m:g}" for m in wanted])
    upper.set_xlabel("metres travelled")
