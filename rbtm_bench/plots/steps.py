"""Which model scan every scan used: the paper's Fig. 2 as a plot over a whole run."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from rbtm_bench.core.columns import DEGENERATE
from rbtm_bench.plots import labels, style
from rbtm_bench.plots.folder import Steps, read_steps
from rbtm_bench.runs.stored import Run

LEAST = 1e-5
"""Smaller eigenvalues are drawn at this one."""
LONG = 1000
"""Scans from which on a figure takes both columns."""

MARKS: dict[str, tuple[str, dict[str, Any]]] = {
    "registered": ("registered", {"marker": ".", "color": "0.2", "ms": 4.0, "mew": 0}),
    "fallback": (
        "fallback",
        {"marker": "^", "mec": style.VERMILION, "mfc": "none", "ms": 4.5, "mew": 0.8},
    ),
    "predicted": ("predicted", {"marker": "x", "color": style.BLUE, "ms": 4.5, "mew": 1.0}),
    "skipped": ("skipped", {"marker": "|", "color": style.BLACK, "ms": 5.0, "mew": 0.8}),
    "still": ("still", {"marker": "_", "color": "0.5", "ms": 4.0, "mew": 0.8}),
    "unusable": (
        "unusable",
        {"marker": "s", "mec": style.SKY, "mfc": "none", "ms": 4.5, "mew": 1.0},
    ),
}
"""Status -> word and marker; they differ by shape, so also in grey. The first scan has none."""


def gaps(run: Run) -> Figure | None:
    """Gap to the model scan over the scans, below it the similarity to that scan where it is
    known, and how well the matched surfaces hold the motion; None without steps."""
    steps = read_steps(run)
    if steps is None:
        return None
    scored, held = bool(np.isfinite(steps.score).any()), bool(np.isfinite(steps.held).any())
    width = style.DOUBLE if len(steps.scan) > LONG else style.SINGLE
    figure = Figure(figsize=(width, 2.6 + 1.3 * (scored + held)))
    axes = figure.subplots(1 + scored + held, 1, sharex=True, squeeze=False)[:, 0]
    handles = _gap_panel(axes[0], steps)
    if scored:
        handles += _score_panel(axes[1], steps, labels.section(run, "selector").get("threshold"))
    if held:
        handles += _localizability_panel(axes[-1], steps)
    axes[-1].set_xlabel("scan number")
    axes[-1].xaxis.set_major_locator(MaxNLocator(6, integer=True))
    lines = [labels.title(run), _summary(run)]
    style.title(figure, "\n".join(line for line in lines if line), width)
    style.legend_below(figure, handles, columns=2 if width == style.SINGLE else 5)
    return figure


def _gap_panel(ax: Axes, steps: Steps) -> list[Line2D]:
    """The gaps; a scan without a model scan is marked at gap 0."""
    heights = np.where(np.isfinite(steps.gap), steps.gap, 0.0)
    handles = []
    for status, (word, look) in MARKS.items():
        chosen = steps.status == status
        if not chosen.any():
            continue
        without = "" if np.isfinite(steps.gap[chosen]).any() else ", no model: drawn at 0"
        handles += _marks(
            ax, steps.scan[chosen], heights[chosen], look, len(steps.scan),
            f"{word} ({int(chosen.sum())}{without})",
        )  # fmt: skip
    ax.set_ylabel("gap to model scan\n(scans)")
    ax.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    top = max(float(heights.max()), 1.0)
    ax.set_ylim(-0.08 * top, 1.08 * top)
    return handles


def _score_panel(ax: Axes, steps: Steps, threshold: float | None) -> list[Line2D]:
    """The similarity to the model scan, with the threshold."""
    for status, (_, look) in MARKS.items():
        chosen = (steps.status == status) & np.isfinite(steps.score)
        _marks(ax, steps.scan[chosen], steps.score[chosen], look, len(steps.scan), None)
    ax.set_ylabel("similarity S to\nmodel scan")
    ax.yaxis.set_major_locator(MaxNLocator(5))
    if threshold is None:
        return []
    line = ax.axhline(threshold, color=style.BLUE, lw=1.0, ls="--", zorder=3)
    line.set_label(f"threshold {threshold:g}")
    return [line]


def _localizability_panel(ax: Axes, steps: Steps) -> list[Line2D]:
    """The smallest eigenvalue, with the line below which a direction counts as unseen."""
    shown = np.maximum(steps.held, LEAST)
    for status, (_, look) in MARKS.items():
        chosen = (steps.status == status) & np.isfinite(shown)
        _marks(ax, steps.scan[chosen], shown[chosen], look, len(steps.scan), None)
    ax.set_yscale("log")
    ax.set_ylim(0.7 * LEAST, 1.0)
    ax.set_ylabel("localizability\n(smallest share)")
    line = ax.axhline(DEGENERATE, color=style.BLACK, lw=1.0, ls=":", zorder=3)
    line.set_label(f"degenerate below {DEGENERATE:g}")
    return [line]


def _marks(
    ax: Axes, x: Any, y: Any, look: dict[str, Any], total: int, label: str | None
) -> list[Line2D]:
    small = {**look, "ms": look["ms"] * (0.6 if total > LONG else 1.0)}
    ax.plot(x, y, ls="", **small, rasterized=len(x) >= style.RASTER_FROM)
    return [Line2D([], [], ls="", **{**look, "ms": look["ms"] + 1}, label=label)]


def _summary(run: Run) -> str:
    """The key numbers: mean gap, rejected registrations, error."""
    words = []
    mean = labels.value(run, "mean_gap")
    if mean is not None:
        words.append(f"mean gap {labels.quantity(mean, 'scan' if mean == 1 else 'scans')}")
    rejected = labels.value(run, "rejected")
    if rejected:
        words.append(f"{rejected:.0f} registrations rejected")
    error = labels.error_words(run)
    return ", ".join([*words, error] if error else words)
