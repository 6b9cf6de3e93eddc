"""Labels beside markers, where they cover neither markers nor each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Bbox

from rbtm_bench.plots import style

Place = tuple[float, float]
"""x and y in data."""

SIZE = 0.85
"""Of a label, of the font's."""
NEAR = (6.0, 10.0, 15.0, 22.0, 30.0)
"""Points from a marker's middle to the edge of its label."""
TIED = 12.0
"""Points from which on a line ties the label to its marker."""
ANGLES = np.deg2rad(np.arange(0.0, 360.0, 22.5))
RADIUS = 4.0
"""Of a marker, points."""
AWAY = 0.8
"""What a point of distance costs, in square points of overlap."""
OVER_LINE = 0.25
"""What a square point of overlap with a line costs."""
TIE: dict[str, Any] = {"arrowstyle": "-", "lw": 0.5, "color": "0.5", "shrinkA": 0, "shrinkB": 2.5}
HALO = withStroke(linewidth=2.0, foreground="w")
"""Around letters that cross a line."""


@dataclass(frozen=True)
class Label:
    """A text for any one of these places."""

    text: str
    places: tuple[Place, ...]
    colour: str = style.BLACK


def place(
    figure: Figure,
    ax: Axes,
    labels: Sequence[Label],
    markers: Sequence[Place],
    corners: Sequence[Place] = (),
) -> None:
    """Write the labels, those with the fewest places first. ``corners`` are of a line that they
    should rather not cover. Call it last: the axes must have their size and limits."""
    figure.draw_without_rendering()
    scale = 72 / figure.dpi
    inner = ax.get_window_extent().transformed(figure.dpi_scale_trans.inverted())
    inner = Bbox(72 * inner.get_points())

    def at(spot: Place) -> Any:
        return scale * ax.transData.transform(spot)

    taken = [_around(*at(marker)) for marker in markers]
    line = _boxes([at(corner) for corner in corners], inner)
    for label in sorted(labels, key=lambda label: len(label.places)):
        width, height = 72 * SIZE * style.inches(label.text), 1.15 * SIZE * style.font()
        best: tuple[float, Place, Any, Bbox] | None = None
        for spot in label.places:
            middle = at(spot)
            for far in NEAR:
                for angle in ANGLES:
                    offset = _offset(far, angle, width, height)
                    x, y = middle + offset - [width / 2, height / 2]
                    box = Bbox.from_bounds(x, y, width, height)
                    cost = AWAY * far + _overlap(box, taken) + OVER_LINE * _overlap(box, line)
                    cost += 1e3 * (1 - _share(box, inner))
                    if best is None or cost < best[0]:
                        best = (cost, spot, offset, box)
        assert best is not None
        _, spot, offset, box = best
        taken.append(box)
        tied = np.hypot(*_gap(box, at(spot))) > TIED
        note = ax.annotate(
            label.text, spot, xytext=tuple(offset), textcoords="offset points",
            ha="center", va="center", fontsize=SIZE * style.font(), zorder=10, color=label.colour,
            arrowprops=TIE if tied else None, path_effects=[HALO],
        )  # fmt: skip
        note.set_in_layout(False)


def _around(x: float, y: float) -> Bbox:
    return Bbox.from_extents(x - RADIUS, y - RADIUS, x + RADIUS, y + RADIUS)


def _offset(far: float, angle: float, width: float, height: float) -> Any:
    """From the marker to the middle of a label whose edge is ``far`` away."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([cos * (far + width / 2), sin * (far + height / 2)])


def _gap(box: Bbox, point: Any) -> tuple[float, float]:
    """How far a point is outside a box, across and up."""
    x = max(box.x0 - point[0], 0.0, point[0] - box.x1)
    y = max(box.y0 - point[1], 0.0, point[1] - box.y1)
    return x, y


def _boxes(corners: Sequence[Any], inner: Bbox) -> list[Bbox]:
    """Thin boxes along a line of horizontal and vertical pieces."""
    out = []
    for start, end in pairwise(corners):
        both = np.clip([start, end], inner.min, inner.max)
        (x0, y0), (x1, y1) = both.min(axis=0) - 1, both.max(axis=0) + 1
        out.append(Bbox.from_extents(x0, y0, x1, y1))
    return out


def _overlap(box: Bbox, others: Sequence[Bbox]) -> float:
    """Area that a box shares with others, square points."""
    return sum(
        common.width * common.height
        for other in others
        if (common := Bbox.intersection(box, other)) is not None
    )


def _share(box: Bbox, inner: Bbox) -> float:
    common = Bbox.intersection(box, inner)
    return 0.0 if common is None else common.width * common.height / (box.width * box.height)
