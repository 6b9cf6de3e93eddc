"""Do errors rise abruptly when the similarity falls below some threshold, as the paper says?

A knee is a logistic step of log10 error over the score, beside a gradual trend (a cubic): with
f = 1 / (1 + exp((s - threshold) / tau)), which is 1 well below the threshold and 0 above,

    log10 error = cubic(s) + height f

It is present if the step's height is larger than resampling explains, anywhere and of any width up
to a quarter of the scores' range: the largest of its t values against that of 1000 sets of data
without a step, made by turning the sign of whole blocks' residuals (a score test by wild cluster
bootstrap). The intervals of threshold, width (10 to 90 % of the step) and height are from
resampled blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rbtm_bench.calibration.roc import percentiles, resampled
from rbtm_bench.core.types import Array
from rbtm_bench.report.intervals import SEED

PLACES = 30
"""Thresholds that are looked at: quantiles of the scores from 5 to 95 percent."""
WIDTHS = (0.01, 0.03, 0.08, 0.25)
"""10 to 90 % of a step, as shares of the scores' range (5 to 95 percent)."""
TAUS = 2.0 * float(np.log(9.0))
"""The width from 10 to 90 % in units of tau."""
DEGREE = 3
EDGE = 0.05
FEWEST_PAIRS, FEWEST_BLOCKS = 40, 6
"""With fewer defined scores or blocks it stays open whether errors have a knee."""
FLOOR_M = 1e-4
"""Errors below this (m) count as this: their logarithm would say nothing about success."""
RESAMPLES = 1000
LEVEL, POWER_Z = 0.05, 0.84
"""Of the test; and the normal quantile of a power of 80 %."""


@dataclass(frozen=True)
class Ends:
    """A number with its interval."""

    value: float
    low: float | None
    high: float | None

    def __str__(self) -> str:
        if self.low is None:
            return f"{self.value:.3g}"
        return f"{self.value:.3g} [{self.low:.3g}, {self.high:.3g}]"


@dataclass(frozen=True)
class Knee:
    """Whether a knee is ``present`` (``p`` of the test), in words ``why``. ``threshold`` and
    ``width`` of the score, ``rise``: by which factor errors below are larger than above; of the
    step that fits best, present or not. ``smallest``: the rise of a sharp step in the middle of
    the scores that these data would have shown four times in five."""

    present: bool
    why: str
    p: float | None = None
    threshold: Ends | None = None
    width: Ends | None = None
    rise: Ends | None = None
    smallest: float | None = None


def knee(scores: ArrayLike, errors: ArrayLike, clusters: ArrayLike) -> Knee:
    """Look for a knee in errors (K,) m over scores (K,). A failed registration (NaN) counts as the
    largest error; pairs without a score are left out."""
    s, e = np.asarray(scores, np.float64), np.asarray(errors, np.float64)
    defined = np.isfinite(s)
    s, e, labels = s[defined], e[defined], np.asarray(clusters)[defined]
    labels = np.unique(labels, return_inverse=True)[1]
    blocks, known = int(labels.max(initial=-1)) + 1, np.isfinite(e)
    if len(s) < FEWEST_PAIRS or blocks < FEWEST_BLOCKS or not known.any():
        return Knee(False, f"cannot be said: {len(s)} pairs with a score in {blocks} blocks")
    low, high = np.quantile(s, [EDGE, 1 - EDGE])
    if high - low < 1e-9:
        return Knee(False, "cannot be said: nearly all scores are equal")
    y = np.log10(np.maximum(np.where(known, e, e[known].max()), FLOOR_M))
    if np.ptp(y) < 1e-9:
        return Knee(False, "cannot be said: all errors are equal")
    places = np.unique(np.quantile(s, np.linspace(EDGE, 1 - EDGE, PLACES)))
    steps = [(t, w * (high - low)) for t in places[places > s.min()] for w in WIDTHS]
    if not steps:
        return Knee(False, "cannot be said: nearly all scores are equal")
    F = np.stack([_step(s, t, w) for t, w in steps], axis=1)
    p, critical = _test(F, s, y, labels)
    present = p < LEVEL
    threshold, width, rise = _estimates(F, np.array(steps), s, y, labels)
    smallest = _smallest(_step(s, float(np.median(s)), steps[0][1]), s, y, labels, critical)
    facts = p, threshold, width, rise, smallest
    if present:
        words = f"knee at {threshold}: errors below are {rise} times those above, within {width}"
        return Knee(True, f"{words} of the score (p {p:.2g})", *facts)
    return Knee(
        False,
        f"none (p {p:.2g}); a sharp rise of less than {smallest:.2g} times would not have shown",
        *facts,
    )


def _step(s: Array, threshold: float, width: float) -> Array:
    return np.asarray(0.5 - 0.5 * np.tanh(0.5 * TAUS * (s - threshold) / width))


def _beside_trend(F: Array, s: Array, y: Array) -> tuple[Array, Array]:
    """What the gradual trend leaves of steps (K, M) and of y (K,)."""
    x = (s - s.mean()) / s.std()
    Q = np.linalg.qr(np.stack([x**d for d in range(DEGREE + 1)], axis=1))[0]
    return F - Q @ (Q.T @ F), y - Q @ (Q.T @ y)


def _per_block(values: Array, labels: NDArray[np.intp]) -> Array:
    """Sums (B, ...) over the blocks of values (K, ...)."""
    sums = np.zeros((int(labels.max()) + 1, *values.shape[1:]))
    np.add.at(sums, labels, values)
    return sums


def _test(F: Array, s: Array, y: Array, labels: NDArray[np.intp]) -> tuple[float, float]:
    """p of the largest t value of a rise below, and the value that 5 % of data without exceed."""
    left, residual = _beside_trend(F, s, y)
    square = (left**2).sum(axis=0)
    left, square = left[:, square > 1e-6 * len(s)], square[square > 1e-6 * len(s)]
    by_block = _per_block(left * residual[:, None], labels)
    scale = np.sqrt((by_block**2).sum(axis=0))
    if not (scale > 0).any():
        return 1.0, float("inf")
    product = by_block.sum(axis=0)
    by_block = by_block[:, scale > 0] / scale[scale > 0]
    t = float(by_block.sum(axis=0).max())
    signs = np.random.default_rng(SEED).choice([-1.0, 1.0], (RESAMPLES, len(by_block)))
    without = (signs @ by_block).max(axis=1)
    p = (1 + int((without >= t - 1e-12).sum())) / (1 + RESAMPLES)
    # where errors fall abruptly, the trend swings beside it: that is no rise
    rises = product[np.argmax(product**2 / square)] > 0
    return p if rises else 1.0, float(np.quantile(without, 1 - LEVEL))


def _smallest(f: Array, s: Array, y: Array, labels: NDArray[np.intp], critical: float) -> float:
    """The rise (a factor) that the test finds four times in five, of one step (K,)."""
    left, residual = _beside_trend(f[:, None], s, y)
    square = float((left**2).sum())
    height = float(left[:, 0] @ residual) / square
    scores = _per_block(left[:, 0] * (residual - height * left[:, 0]), labels)
    error = float(np.sqrt((scores**2).sum())) / square
    return float(10 ** ((critical + POWER_Z) * error))


def _estimates(
    F: Array, steps: Array, s: Array, y: Array, labels: NDArray[np.intp]
) -> tuple[Ends, Ends, Ends]:
    """Threshold, width and rise of the step that fits best beside the trend, with percentile
    intervals over resampled blocks: a resample is a weighted sum of the blocks' sums."""
    left, residual = _beside_trend(F, s, y)
    squares, products = (_per_block(a, labels) for a in (left**2, left * residual[:, None]))

    def fit(times: Array) -> tuple[NDArray[np.intp], Array]:
        square = np.maximum(times @ squares, 1e-12)
        height = np.maximum(times @ products, 0.0) / square
        best = np.argmax(height**2 * square, axis=1)  # what it takes from the sum of squares
        return best, height[np.arange(len(times)), best]

    blocks = len(squares)
    (best,), (height,) = fit(np.ones((1, blocks)))
    drawn, heights = fit(resampled(blocks, RESAMPLES))
    return (
        Ends(float(steps[best, 0]), *percentiles(steps[drawn, 0])),
        Ends(float(steps[best, 1]), *percentiles(steps[drawn, 1])),
        Ends(float(10**height), *percentiles(10**heights)),
    )
