"""The Hough domain of planar points, compiled: spectrum, columns, correlations and their peaks.

A column HT(theta, .) of the Hough transform says how much of the scan lies on each line with
normal direction theta, by the line's distance rho from the scan's middle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.types import Array


@kernel
def cells_for(reach: float, cell: float) -> int:
    """How many cells of ``cell`` m hold -``reach`` ... ``reach`` m; always an odd number."""
    return 2 * int(np.ceil(reach / cell)) + 5


@kernel
def vote(
    xy: Array,
    weights: Array,
    rotation: tuple[float, float],
    angle: float,
    cell: float,
    reach: float,
) -> Array:
    """The column (C,) at ``angle`` (rad) of points (N, 2) m about their middle, turned first by
    ``rotation`` (cosine, sine); each vote is shared by the two cells that it falls between."""
    column = np.zeros(cells_for(reach, cell))
    middle = len(column) // 2
    c, s = rotation
    along, across = np.cos(angle) / cell, np.sin(angle) / cell
    u, v = c * along + s * across, c * across - s * along
    for i in range(len(xy)):
        place = xy[i, 0] * u + xy[i, 1] * v + middle
        low = int(place)
        share = place - low
        column[low] += weights[i] * (1.0 - share)
        column[low + 1] += weights[i] * share
    return column


@kernel
def hough_spectrum(xy: Array, weights: Array, reach: float, cell: float, count: int) -> Array:
    """HS(theta) (count,) over [0, pi): the sum of squares of each column, smoothed by (1 2 1) / 4
    so that it depends little on where the cells happen to lie."""
    out = np.empty(count)
    for k in range(count):
        column = vote(xy, weights, (1.0, 0.0), np.pi * k / count, cell, reach)
        total = 0.0
        for i in range(1, len(column) - 1):
            smooth = 0.25 * column[i - 1] + 0.5 * column[i] + 0.25 * column[i + 1]
            total += smooth * smooth
        out[k] = total
    return out


@kernel
def correlate_spectra(target: Array, source: Array) -> Array:
    """Circular cross-correlation (K,): at s, how well the source turned by s bins fits."""
    count = len(target)
    out = np.zeros(count)
    for s in range(count):
        for k in range(count):
            out[s] += target[(k + s) % count] * source[k]
    return out


@kernel
def correlate_columns(target: Array, source: Array, low: int, out: Array) -> None:
    """Cross-correlation, written to ``out`` (L,): how well the source shifted by ``low``, low + 1
    ... cells fits, both counted from their middle."""
    out[:] = 0.0
    base = len(target) // 2 - len(source) // 2
    for c in range(len(source)):
        if source[c] == 0.0:
            continue
        start = c + low + base  # the target's cell for the first shift
        first, last = max(0, -start), min(len(out), len(target) - start)
        if first >= last:
            continue
        sums, cells, value = out[first:last], target[start + first : start + last], source[c]
        for s in range(len(sums)):  # views counted from 0, or it is not vectorised
            sums[s] += value * cells[s]


@kernel
def neighbours(values: Array, i: int, is_circular: bool) -> tuple[float, float]:
    """The values before and after place ``i``; beyond the end of a line they are 0."""
    last = len(values) - 1
    before = values[i - 1] if i > 0 else (values[last] if is_circular else 0.0)
    after = values[i + 1] if i < last else (values[0] if is_circular else 0.0)
    return before, after


@kernel
def peaks(
    values: Array, is_circular: bool, allowed: NDArray[np.bool_], most: int, apart: float
) -> Array:
    """Places (P,) of the highest local maxima among ``allowed`` ones, at most ``most`` and at
    least ``apart`` bins from each other, highest first; between bins by a parabola."""
    count = len(values)
    is_open = np.zeros(count, dtype=np.bool_)
    for i in range(count):
        before, after = neighbours(values, i, is_circular)
        is_open[i] = allowed[i] and values[i] > 0.0 and values[i] >= before and values[i] > after
    places = np.empty(most)
    n = 0
    while n < most:
        best = -1
        for i in range(count):
            if is_open[i] and (best < 0 or values[i] > values[best]):
                best = i
        if best < 0:
            break
        before, after = neighbours(values, best, is_circular)
        bend = before - 2.0 * values[best] + after
        places[n] = best + (0.5 * (before - after) / bend if bend < 0.0 else 0.0)
        n += 1
        for i in range(count):
            distance = abs(i - best)
            if is_circular:
                distance = min(distance, count - distance)
            if distance < apart:
                is_open[i] = False
        is_open[best] = False
    return places[:n]


@kernel
def directions(target: Array, source: Array, shift: int, most: int) -> NDArray[np.int64]:
    """Bins (most,) of the directions that tell most about the translation: both spectra high, the
    source's turned by ``shift`` bins, and across the directions already chosen."""
    count = len(target)
    value = np.empty(count)
    for k in range(count):
        value[k] = target[k] * source[(k - shift) % count]
    out = np.empty(most, dtype=np.int64)
    for i in range(most):
        out[i] = np.argmax(value)
        for k in range(count):
            value[k] *= np.sin(np.pi * (k - out[i]) / count) ** 2
    return out
