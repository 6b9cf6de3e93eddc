"""Correlative matching of prepared planar scans: what ``csm_2d`` and ``search.correlative`` do."""

from __future__ import annotations

import math
from collections import OrderedDict

import numpy as np

from rbtm_bench.backends.base import Prepared
from rbtm_bench.backends.correlative_search import Peak, Window, search, thinned, turns_of
from rbtm_bench.backends.likelihood_field import Field, field_of, with_widest
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import yaw
from rbtm_bench.core.types import Array

FIELDS_KEPT = 4
"""Targets whose fields are remembered: some MB each."""


class CorrelativeMatcher:
    """Searches a window of poses for the one under which the source's points are likeliest to lie
    where the target has some.

    ``cell_size`` m is the step between two shifts and the side of the field's cells, ``sigma`` m
    how far from a target point the likelihood exp(-d^2 / (2 sigma^2)) falls to .61; source points
    are thinned to one a cell along the scan. ``apart`` (m) and ``apart_deg`` say which other poses
    a second peak is looked for among; an ``apart`` of 0: none is.
    """

    def __init__(
        self, cell_size: float, sigma: float, apart: float = 0.0, apart_deg: float = 0.0
    ) -> None:
        self.cell_size, self.sigma = float(cell_size), float(sigma)
        self.apart, self.apart_turn = float(apart), math.radians(apart_deg)
        self._fields: OrderedDict[int, tuple[Prepared, Field]] = OrderedDict()
        corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)
        square = Prepared(corners, True, None)
        self.match(square, square, np.eye(4), 0.1, 0.1)  # compiles the kernels
        self.forget()

    def forget(self) -> None:
        """Keep no target's field."""
        self._fields.clear()

    def match(
        self,
        source: Prepared,
        target: Prepared,
        T_target_source: Array,
        translation: float | None,
        rotation: float,
    ) -> Peak:
        """The best pose up to ``translation`` m along x and y and ``rotation`` rad from the guess
        (4, 4). With a translation of None the source's origin may lie anywhere in the target's
        bounding box. Raises ``BackendError`` for a target or a window too large for a table.
        """
        points = self.points(source)
        x, y, theta = T_target_source[0, 3], T_target_source[1, 3], float(yaw(T_target_source))
        if translation is None:
            low, high = target.points.min(axis=0), target.points.max(axis=0)
            x, y = 0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])
            translation = 0.5 * float(max(high[0] - low[0], high[1] - low[1]))
        cells = math.ceil(translation / self.cell_size - 1e-9)
        turns = turns_of(points, self.cell_size, rotation)
        window = Window(float(x), float(y), theta, cells, turns)
        field = self.field(target, window.is_wide)
        return search(points, field, window, self.apart, self.apart_turn)

    def points(self, source: Prepared) -> Array:
        """The source points (M, 2) m that are looked at."""
        return thinned(source.points, self.cell_size)

    def field(self, target: Prepared, is_wide: bool = False) -> Field:
        """The target's field, for a wide window if ``is_wide``; those of the last few targets are
        kept."""
        known = self._fields.get(id(target))
        if known is None:
            field = field_of(target.points, self.cell_size, self.sigma)
            if field is None:
                raise BackendError("the target's points lie too far apart for a field of cells")
            known = self._fields[id(target)] = (target, field)  # so that the id stays its own
            if len(self._fields) > FIELDS_KEPT:
                self._fields.popitem(last=False)
        if is_wide:
            known = self._fields[id(target)] = (target, with_widest(known[1]))
        self._fields.move_to_end(id(target))
        return known[1]
