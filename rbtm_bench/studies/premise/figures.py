"""The figures of scripts/premise.py."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from rbtm_bench.plots import panels, style
from rbtm_bench.plots.looks import Look
from rbtm_bench.studies.premise.plan import BOUNDS, NOTHING, STRATEGIES, Place
from rbtm_bench.studies.premise.words import PremiseTables

LOOKS = {
    "open3d_p2p": Look("-", 1.0, "D", filled=True, colour=style.VERMILION),
    "open3d_p2plane": Look("-", 1.0, "o", colour=style.BLUE),
    "plicp": Look("-", 1.0, "s", filled=True, colour=style.BLACK),
}
SPARE = Look("-", 1.0, "^", colour="0.45")
SHOWN = ("rbtm", "rbtm_overlap")
LEAST = -3.0
"""Shares below this are drawn at it."""
ROW = 0.19
"""Height of a strategy, inches."""
APART = 0.22
"""Between the backends of a strategy, in rows."""


def draw(tables: PremiseTables, places: Sequence[Place], out: Path) -> list[Path]:
    """``errors`` and ``shares`` as PNG and PDF; returns the PNGs."""
    written = []
    with style.paper():
        for kind in dict.fromkeys(place.kind.name for place in places):
            of_kind = [place for place in places if place.kind.name == kind]
            written += style.save(_errors(tables.table, of_kind), out, f"errors_{kind}")
        if len(tables.all_shares):
            names = {place.name: place.title for place in places}
            written += style.save(_shares(tables.all_shares, names), out, "shares")
    return [file for file in written if file.suffix == ".png"]


def _errors(table: pd.DataFrame, places: Sequence[Place]) -> Figure:
    """Errors with their intervals, a panel a place; the guess alone as a dotted line."""
    order = [*STRATEGIES, *(BOUNDS if places[0].kind.truth else ())]
    columns = 2 if len(places) > 3 else len(places)
    rows = -(-len(places) // columns)
    backends = [b for b in dict.fromkeys(table["backend"]) if b != NOTHING]
    height = rows * (len(order) * ROW + 0.55) + 0.6
    figure = Figure(figsize=(style.DOUBLE, height))
    grid = figure.subplots(rows, columns, sharey=True, squeeze=False)
    for ax, place in zip(grid.ravel(), places, strict=False):
        _error_panel(ax, table[table["place"] == place.name], order, backends)
        ax.set_title(style.plain(place.title))
        unit = "mm" if place.kind.seeds else "m"
        ax.set_xlabel(f"{'final position' if place.kind.seeds else 'mean relative'} error ({unit})")
    for ax in grid.ravel()[len(places) :]:
        ax.remove()
    what = "median of seeds" if places[0].kind.seeds else "mean"
    handles = [panels.handle(b, **{**look(b).line, **look(b).mark}) for b in backends]
    handles.append(panels.handle("the guess alone", color="0.35", lw=1.0, ls=(0, (1, 1.5))))
    figure.suptitle(f"{places[0].kind.title}: {what}, bootstrap 95% intervals")
    style.legend_below(figure, handles, 4)
    return figure


def _error_panel(
    ax: Axes, table: pd.DataFrame, order: Sequence[str], backends: Sequence[str]
) -> None:
    rows = {(r["backend"], r["strategy"]): r for _, r in table.iterrows()}
    for i, strategy in enumerate(order):
        for j, backend in enumerate(backends):
            row = rows.get((backend, strategy))
            if row is None or not np.isfinite(row["error"]):
                continue
            y, own = i + APART * (j - (len(backends) - 1) / 2), look(backend)
            if np.isfinite(row["low"]):
                ax.plot([row["low"], row["high"]], [y, y], color=own.colour, lw=1.0, zorder=2)
            ax.plot([row["error"]], [y], **{**own.mark, "ms": 3.5, "mew": 0.8}, ls="", zorder=3)
    nothing = rows.get((NOTHING, NOTHING))
    if nothing is not None:
        ax.axvline(nothing["error"], color="0.35", lw=1.0, ls=(0, (1, 1.5)), zorder=1)
    ax.set_xscale("log")
    ax.set_yticks(range(len(order)), list(order))
    ax.set_ylim(len(order) - 0.4, -0.6)
    ax.yaxis.set_minor_locator(NullLocator())
    for i in range(1, len(order)):
        ax.axhline(i - 0.5, color="0.92", lw=0.6, zorder=0)


def _shares(table: pd.DataFrame, names: dict[str, str]) -> Figure:
    """The share of the way from random gaps to the oracle that RBTM covers."""
    shown = table[(table["bound"] == "oracle") & table["strategy"].isin(SHOWN)]
    places = [name for name in names if name in set(shown["place"])]
    backends = list(dict.fromkeys(shown["backend"]))
    figure = Figure(figsize=(style.DOUBLE, len(places) * ROW * 1.3 + 1.2))
    grid = figure.subplots(1, len(SHOWN), sharey=True, sharex=True, squeeze=False)
    for ax, strategy in zip(grid.ravel(), SHOWN, strict=True):
        rows = shown[shown["strategy"] == strategy]
        for i, place in enumerate(places):
            for j, backend in enumerate(backends):
                y = i + APART * (j - (len(backends) - 1) / 2)
                _one_share(ax, rows[(rows.place == place) & (rows.backend == backend)], y)
        ax.axvline(0.0, color="0.35", lw=0.8)
        ax.axvline(1.0, color="0.35", lw=0.8, ls=(0, (1, 1.5)))
        ax.set_title(strategy)
        ax.set_xlabel("share of the way covered")
        ax.set_yticks(range(len(places)), [names[name] for name in places])
        ax.set_ylim(len(places) - 0.4, -0.6)
        ax.set_xlim(LEAST - 0.1, 1.6)
    handles = [panels.handle(b, **{**look(b).line, **look(b).mark}) for b in backends]
    title = "0: the method's own gaps in random order; 1: what the truth chooses"
    figure.suptitle(f"{title}; 95% intervals, cut at {LEAST:g}")
    style.legend_below(figure, handles, 4)
    return figure


def _one_share(ax: Axes, rows: pd.DataFrame, y: float) -> None:
    for _, row in rows.iterrows():
        if np.isfinite(row["share"]):
            own = look(str(row["backend"]))
            low, value, high = np.clip([row["low"], row["share"], row["high"]], LEAST, 1.5)
            ax.plot([low, high], [y, y], color=own.colour, lw=1.0, zorder=2)
            ax.plot([value], [y], **{**own.mark, "ms": 3.5, "mew": 0.8}, ls="", zorder=3)


def look(backend: str) -> Look:
    """A backend's marker and colour."""
    return LOOKS.get(backend, SPARE)
