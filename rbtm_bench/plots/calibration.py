"""Figures of a calibration: error against similarity, success over it, areas of predictors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import PercentFormatter

from rbtm_bench.core.types import Array
from rbtm_bench.plots import style
from rbtm_bench.plots.looks import GREY, Look, numbered

COLUMNS = 3
PANEL = (2.2, 1.9)
"""Width and height of a panel, inches."""
BAND = "0.8"
PREDICTORS = {
    "gap": "gap",
    "travelled_m": "distance travelled",
    "distance_m": "distance between",
    "rotation_deg": "rotation between",
}
KINDS = {"gap": "pairs across gaps", "revisit": "revisits"}


def figures(
    pairs: pd.DataFrame,
    scores: Mapping[str, Array],
    curves: pd.DataFrame,
    roc: pd.DataFrame,
    within: tuple[float, float],
    data: str,
) -> list[tuple[str, Figure]]:
    """Every figure with its file's stem. ``pairs``: a row a pair and backend, backends one after
    the other; ``scores`` (K,) by similarity, of the pairs; ``data`` names the data in every
    title."""
    drawn = []
    for name, values in scores.items():
        some = curves[(curves["similarity"] == name)]
        if some.empty:
            continue
        drawn.append((f"error-{name}", _errors(pairs, name, values, some, within)))
        drawn.append((f"success-{name}", _success(name, some, within)))
    for kind in KINDS:
        some = roc[(roc["pairs"] == kind) & (roc["part"] == "all")]
        if some["auc"].notna().any():
            drawn.append((f"roc_areas-{kind}", _areas(some, kind, within)))
    for _, figure in drawn:
        title = figure.get_suptitle().replace("\n", " ")
        width = figure.get_figwidth()
        figure.suptitle(
            style.wrapped(f"{data}\n", width).strip() + "\n" + style.wrapped(title, width)
        )
    return drawn


def _limit(within: tuple[float, float]) -> str:
    return f"within {within[0]:g} m and {within[1]:g} deg"


def _errors(
    pairs: pd.DataFrame,
    name: str,
    scores: Array,
    curves: pd.DataFrame,
    within: tuple[float, float],
) -> Figure:
    """Every pair across gaps, the median, and a band up to the 90% quantile; a panel a backend."""
    backends = list(dict.fromkeys(pairs["backend"]))
    columns = min(COLUMNS, len(backends))
    rows = -(-len(backends) // columns)
    width = max(style.SINGLE, columns * PANEL[0] + 0.5)
    figure = Figure(figsize=(width, rows * PANEL[1] + 1.1))
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    lowest = np.nanquantile(pairs["error_m"], 0.002) if pairs["error_m"].notna().any() else 1e-3
    for ax, backend in zip(axes.flat, backends, strict=False):
        mine = (pairs["backend"] == backend).to_numpy()
        across = (pairs["kind"][mine] == "gap").to_numpy()
        error = np.maximum(pairs["error_m"].to_numpy()[mine][across], lowest)
        ax.plot(scores[across], error, ",", color="0.6", zorder=1, rasterized=True)
        ax.plot(scores[across], error, ".", ms=1.6, mew=0, color="0.55", zorder=1, rasterized=True)
        bins = curves[
            (curves["backend"] == backend)
            & (curves["pairs"] == "gap")
            & (curves["gap"] == "all")
            & (curves["bin"] != "undefined")
        ]
        _band(ax, bins, lowest)
        ax.axhline(within[0], color=style.VERMILION, lw=1.0, ls=(0, (4, 2)), zorder=4)
        ax.set(yscale="log", title=style.wrapped(backend, PANEL[0]))
    for ax in axes[-1]:
        ax.set_xlabel(style.wrapped(f"similarity S ({name})", PANEL[0]))
    for ax in axes[:, 0]:
        ax.set_ylabel("translation error (m)")
    for ax in list(axes.flat)[len(backends) :]:
        ax.set_axis_off()
    title = "Registration error against similarity, pairs across gaps"
    figure.suptitle(title)
    handles: list[Any] = [
        Line2D([], [], ls="", marker=".", color="0.55", label="a pair"),
        Line2D([], [], color=style.BLACK, lw=1.6, label="median"),
        Patch(color=BAND, label="50% to 90% of the pairs are below"),
        Line2D([], [], color=style.VERMILION, lw=1.0, ls=(0, (4, 2)), label=f"{within[0]:g} m"),
    ]
    style.legend_below(figure, handles, 4 if width > 5 else 2)
    return figure


def _band(ax: Axes, bins: pd.DataFrame, lowest: float) -> None:
    """Median and 90% quantile of the bins, as steps from end to end."""
    if bins.empty:
        return
    top = ax.get_ylim()[1]
    edges = [*bins["low"], bins["high"].iloc[-1]]
    middle, high = (
        np.clip(bins[f"error_m_q{q}"].to_numpy(np.float64), lowest, 10 * top) for q in (50, 90)
    )
    ax.stairs(high, edges, baseline=middle, fill=True, color=BAND, zorder=0)
    ax.stairs(middle, edges, baseline=None, color=style.BLACK, lw=1.6, zorder=3)


def _success(name: str, curves: pd.DataFrame, within: tuple[float, float]) -> Figure:
    """Success over similarity: of all gaps over the score, and at equal gap over the rank."""
    figure = Figure(figsize=(style.DOUBLE, 3.0))
    left, right = figure.subplots(1, 2, sharey=True)
    backends = list(dict.fromkeys(curves["backend"]))
    handles = []
    for number, backend in enumerate(backends):
        look = numbered(number)
        for ax, gap in ((left, "all"), (right, "equal")):
            bins = curves[
                (curves["backend"] == backend)
                & (curves["pairs"] == "gap")
                & (curves["gap"] == gap)
                & (curves["bin"] != "undefined")
            ]
            _bars(ax, bins, look, (number - (len(backends) - 1) / 2) * 0.008)
        handles.append(Line2D([], [], label=style.plain(backend), **look.line, **look.mark))
    left.set(xlabel=f"similarity S ({name})", title="all gaps", ylabel="success")
    right.set(xlabel="rank of S among pairs of the same gap", title="at equal gap")
    right.set_xlim(0, 1)
    for ax in (left, right):
        ax.set_ylim(-0.03, 1.03)
        ax.yaxis.set_major_formatter(PercentFormatter(1.0))
        ax.xaxis.set_major_formatter(PercentFormatter(1.0)) if ax is right else None
        ax.grid(color="0.9", lw=0.5)
        ax.set_axisbelow(True)
    title = f"Registrations {_limit(within)}, pairs across gaps, with 95% intervals"
    figure.suptitle(title)
    style.legend_below(figure, handles, 4)
    return figure


def _bars(ax: Axes, bins: pd.DataFrame, look: Look, shift: float) -> None:
    """A line through the bins' middles with their intervals; moved aside by a share of the axis."""
    if bins.empty:
        return
    middle = 0.5 * (bins["low"] + bins["high"]).to_numpy(np.float64)
    middle = middle + shift * float(np.ptp([*bins["low"], *bins["high"]]))
    value = bins["success"].to_numpy(np.float64)
    down = value - bins["success_low"].to_numpy(np.float64)
    up = bins["success_high"].to_numpy(np.float64) - value
    ax.errorbar(
        middle, value, yerr=[np.maximum(down, 0), np.maximum(up, 0)], elinewidth=0.8, capsize=1.5,
        ecolor=look.colour, **look.line, **look.mark,
    )  # fmt: skip


def _areas(roc: pd.DataFrame, kind: str, within: tuple[float, float]) -> Figure:
    """Areas with intervals, a line a predictor and a sign a backend; chance is drawn."""
    names: Sequence[str] = list(dict.fromkeys(roc["predictor"]))
    compared = list(dict.fromkeys(roc["compared"]))
    backends = list(dict.fromkeys(roc["backend"]))
    height = 1.2 + len(names) * (0.14 + 0.09 * len(backends))
    width = style.DOUBLE if len(compared) > 1 else style.SINGLE + 0.8
    figure = Figure(figsize=(width, min(height, style.TALLEST)))
    axes = figure.subplots(1, len(compared), sharex=True, sharey=True, squeeze=False)[0]
    for ax, how in zip(axes, compared, strict=True):
        ax.axvline(0.5, color=GREY, lw=1.0, ls=(0, (1, 1.5)))
        for number, backend in enumerate(backends):
            look = numbered(number)
            rows = roc[(roc["compared"] == how) & (roc["backend"] == backend)]
            at = [
                names.index(p) + (number + 0.5) / len(backends) * 0.7 - 0.35
                for p in rows["predictor"]
            ]
            _intervals(ax, rows, at, look)
        ax.set(title=how if kind == "gap" else KINDS[kind], xlabel="area under the ROC curve")
        ax.set_yticks(range(len(names)), [style.plain(PREDICTORS.get(n, n)) for n in names])
        ax.set_ylim(len(names) - 0.5, -0.5)
        ax.grid(axis="x", color="0.9", lw=0.5)
        ax.set_axisbelow(True)
        for line in range(1, len(names)):
            ax.axhline(line - 0.5, color="0.9", lw=0.5)
    handles = [
        Line2D([], [], ls="", label=style.plain(b), **numbered(n).mark)
        for n, b in enumerate(backends)
    ]
    handles.append(Line2D([], [], color=GREY, lw=1.0, ls=(0, (1, 1.5)), label="chance"))
    title = f"How well is success ({_limit(within)}) predicted? {KINDS[kind]}, 95% intervals"
    figure.suptitle(title)
    style.legend_below(figure, handles, 4 if width > 5 else 2)
    return figure


def _intervals(ax: Axes, rows: pd.DataFrame, at: list[float], look: Look) -> None:
    auc, low, high = (rows[c].to_numpy(np.float64) for c in ("auc", "auc_low", "auc_high"))
    for x, a, b, y in zip(auc, low, high, at, strict=True):
        if np.isfinite(a) and np.isfinite(b):
            ax.plot([a, b], [y, y], color=look.colour, lw=1.0)
        ax.plot([x], [y], ls="", **look.mark)
