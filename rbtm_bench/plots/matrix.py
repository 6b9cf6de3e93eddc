"""The similarity of all pairs of a run's scans: the paper's Fig. 1(c)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import MaxNLocator

from rbtm_bench.plots import labels, style
from rbtm_bench.plots.folder import read_similarity
from rbtm_bench.runs.stored import Run

UNDEFINED: dict[str, Any] = {"facecolor": "w", "edgecolor": "0.2", "hatch": "//////", "lw": 0}


def similarity(run: Run) -> Figure | None:
    """The matrix; undefined scores are hatched. None without its file."""
    matrix = read_similarity(run)
    if matrix is None:
        return None
    scans, scores = matrix
    figure = Figure(figsize=(style.SINGLE, style.SINGLE))
    ax = figure.add_subplot()
    half = 0.5 * (scans[-1] - scans[0]) / max(len(scans) - 1, 1) or 0.5
    low, high = float(scans[0]) - half, float(scans[-1]) + half
    # undefined scores are transparent and let the hatched ground show
    ax.add_patch(Rectangle((low, low), high - low, high - low, **UNDEFINED, zorder=0))
    finite = scores[np.isfinite(scores)]
    bottom = min(0.0, math.floor(10 * finite.min()) / 10) if len(finite) else 0.0
    image = ax.imshow(
        np.ma.masked_invalid(scores), extent=(low, high, high, low), vmin=bottom, vmax=1.0,
        cmap="viridis", interpolation="nearest", zorder=1,
    )  # fmt: skip
    beside = ax.inset_axes((1.05, 0.0, 0.05, 1.0))  # as high as the matrix
    bar = figure.colorbar(image, cax=beside, label="similarity S")
    ax.set(xlabel="scan k", ylabel="scan j")
    for side in (ax.xaxis, ax.yaxis):
        side.set_major_locator(MaxNLocator(5, integer=True))
    handles: list[Any] = []
    threshold = labels.section(run, "selector").get("threshold")
    if threshold is not None:
        bar.ax.axhline(threshold, color="w", lw=3.0)
        bar.ax.axhline(threshold, color=style.BLACK, lw=1.2)
        handles.append(Line2D([], [], color=style.BLACK, lw=1.2, label=f"threshold {threshold:g}"))
    if len(finite) < scores.size:
        share = 1 - len(finite) / scores.size
        handles.append(Patch(**UNDEFINED, label=f"undefined ({share:.1%})"))
    lines = [_title(run, scans, scores, threshold)]
    style.title(figure, "\n".join(line for line in lines if line), style.SINGLE)
    style.legend_below(figure, handles, columns=2)
    style.fit_height(figure, [ax], tallest=style.SINGLE)
    return figure


def _title(run: Run, scans: Any, scores: Any, threshold: float | None) -> str:
    """Data set, similarity, how many scans, and how many pairs pass the threshold."""
    name = ", ".join([style.names().data_of(run), *labels.seed_words(run)])
    total = run.record.get("scans")
    if isinstance(total, int) and total > len(scans):
        name += f", {len(scans)} of {total} scans"
    words = f"{name}\nsimilarity: {labels.word(run, 'similarity')}"
    if threshold is None or len(scans) < 2:
        return words
    pairs = scores[np.triu_indices(len(scans), k=1)]
    return f"{words}\n{np.mean(pairs > threshold):.1%} of the pairs above the threshold"
