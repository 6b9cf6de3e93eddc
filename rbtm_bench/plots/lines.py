"""The error over the one setting of a selector that varies, a line a backend."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullLocator

from rbtm_bench.plots import labels, style
from rbtm_bench.plots.studies import LOG_FROM, SettingsStudy, StudyPanel

TICKS = 10
"""Tick labels along the setting's axis at most."""

LOOKS: tuple[dict[str, Any], ...] = (
    {"color": style.BLUE, "marker": "o", "ls": "-"},
    {"color": style.VERMILION, "marker": "s", "ls": "--"},
    {"color": style.BLACK, "marker": "^", "ls": "-."},
    {"color": style.ORANGE, "marker": "D", "ls": ":"},
    {"color": style.SKY, "marker": "v", "ls": "-"},
    {"color": style.NAVY, "marker": "P", "ls": "--"},
)
"""Of the lines of a panel: they differ by shape, so also in grey."""
CONTROL: dict[str, Any] = {"marker": "", "lw": 0.6, "zorder": 1}
FAILED: dict[str, Any] = {"ls": "", "marker": "x", "ms": 5}


def draw(study: SettingsStudy) -> Figure:
    """Medians as lines, bars from the smallest to the largest error; the selector "previous"
    beside them as a thin line. Of many lines a panel holds six."""
    parts = [study.panels[i : i + len(LOOKS)] for i in range(0, len(study.panels), len(LOOKS))]
    columns = min(len(parts), 2)
    rows = -(-len(parts) // columns)
    width = style.SINGLE if columns == 1 else style.DOUBLE
    entries = max(len(part) + len(_remarks(part)) for part in parts)
    figure = Figure(figsize=(width, 0.6 + rows * (2.0 + 0.16 * entries)))
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    axes: list[Axes] = list(grid.ravel())
    for spare in axes[len(parts) :]:
        spare.remove()
    for number, (ax, part) in enumerate(zip(axes, parts, strict=False)):
        for panel, look in zip(part, LOOKS, strict=False):
            _line(ax, panel, look)
        ax.set_xlabel(labels.axis(study.axes[0]))
        ax.tick_params(labelbottom=True)
        if number % columns == 0:
            ax.set_ylabel(f"{study.error} ({study.unit})")
        handles, _ = ax.get_legend_handles_labels()
        ax.legend(
            handles=[*handles, *_remarks(part)],
            loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.3,
        )  # fmt: skip
    _scale(axes[0], study)
    style.title(figure, study.title, width)
    return figure


def _line(ax: Axes, panel: StudyPanel, look: dict[str, Any]) -> None:
    x = sorted(place[0] for place in panel.cells)
    cells = [panel.cells[(value,)] for value in x]
    medians = [cell.median for cell in cells]
    ax.plot(x, medians, **look, ms=4, lw=1.1, label=style.plain(panel.name), zorder=3)
    ax.vlines(
        x, [cell.low for cell in cells], [cell.high for cell in cells],
        color=look["color"], lw=0.8, zorder=2,
    )  # fmt: skip
    failed = [value for value, cell in zip(x, cells, strict=True) if not cell.known]
    foot = [0.03] * len(failed)
    ax.plot(failed, foot, **{**look, **FAILED}, transform=ax.get_xaxis_transform())
    if panel.control is not None:
        ax.axhline(panel.control, **{**look, **CONTROL})


def _remarks(panels: list[StudyPanel]) -> list[Line2D]:
    """What else is in a panel of these."""
    out = []
    if any(panel.control is not None for panel in panels):
        out.append(
            Line2D([], [], color="0.3", **CONTROL, label=labels.member("selector", "previous"))
        )
    if any(not cell.known for panel in panels for cell in panel.cells.values()):
        out.append(Line2D([], [], color="0.3", **FAILED, label="failed"))
    return out


def _scale(ax: Axes, study: SettingsStudy) -> None:
    """Logarithmic where the numbers span more than 20 times."""
    values = study.values(0)
    if values[0] > 0 and values[-1] > LOG_FROM * values[0]:
        ax.set_xscale("log")
    if len(values) <= TICKS:
        ax.set_xticks(values, [f"{value:g}" for value in values])
        ax.xaxis.set_minor_locator(NullLocator())
    controls = [panel.control for panel in study.panels if panel.control is not None]
    errors = [*study.medians, *controls]
    if min(errors) > 0 and max(errors) > LOG_FROM * min(errors):
        ax.set_yscale("log")
    else:
        ax.set_ylim(bottom=0.0)
