"""Do errors rise abruptly when the similarity falls below some threshold, as the paper says?

Two ways in which log error may follow similarity are compared by how well they predict blocks of
pairs that they have not seen: gradually (a polynomial of degree 0 to 3, the best of the four) or
with a knee (two levels, or two straight lines that meet, with the break where it fits best). There
is a knee where the second predicts better, by more than resampling the blocks explains, and errors
are larger below the break than above it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rbtm_bench.calibration.roc import percentiles, resampled
from rbtm_bench.core.types import Array

FOLDS = 10
"""Groups of blocks that are left out in turn."""
BREAKS = 40
"""Places where the break is looked for: quantiles of the scores from 5 to 95 percent."""
EDGE = 0.05
FEWEST_PAIRS, FEWEST_BLOCKS = 40, 6
"""With fewer defined scores or blocks it stays open whether errors have a knee."""
FLOOR_M = 1e-4
"""Errors below this (m) count as this: their logarithm would say nothing about success."""
RESAMPLES = 1000
MODELS = ("constant", "line", "parabola", "cubic", "step", "two lines")
GRADUAL, ABRUPT = MODELS[:4], MODELS[4:]


@dataclass(frozen=True)
class Knee:
    """Whether a knee is ``present``. ``threshold`` with its interval; ``rise``: by which factor the
    median error below is larger than above; ``model``: which of the two abrupt ones fits; ``gain``:
    mean squared error of log10 that the knee saves on unseen blocks, with its interval;
    ``gradual``: the best gradual one. ``why``: the outcome in words, or why it stays open."""

    present: bool
    why: str
    threshold: float | None = None
    low: float | None = None
    high: float | None = None
    rise: float | None = None
    model: str = ""
    gradual: str = ""
    gain: float | None = None
    gain_low: float | None = None
    gain_high: float | None = None


def knee(scores: ArrayLike, errors: ArrayLike, clusters: ArrayLike) -> Knee:
    """Look for a knee in errors (K,) m over scores (K,). A failed registration (NaN) counts as the
    largest error; pairs without a score are left out."""
    s, e = np.asarray(scores, np.float64), np.asarray(errors, np.float64)
    defined = np.isfinite(s)
    s, e, labels = s[defined], e[defined], np.asarray(clusters)[defined]
    labels = np.unique(labels, return_inverse=True)[1]
    blocks = int(labels.max(initial=-1)) + 1
    known = np.isfinite(e)
    if len(s) < FEWEST_PAIRS or blocks < FEWEST_BLOCKS or not known.any():
        return Knee(False, f"cannot be said: {len(s)} pairs with a score in {blocks} blocks")
    breaks = np.unique(np.quantile(s, np.linspace(EDGE, 1 - EDGE, BREAKS)))
    breaks = breaks[breaks > s.min()]  # else no pair is below
    if len(breaks) == 0 or np.ptp(s) < 1e-9:
        return Knee(False, "cannot be said: nearly all scores are equal")
    y = np.log10(np.maximum(np.where(known, e, e[known].max()), FLOOR_M))
    if np.ptp(y) < 1e-9:
        return Knee(False, "cannot be said: all errors are equal")
    x = (s - s.mean()) / s.std()
    designs = _designs(x, (breaks - s.mean()) / s.std())
    losses = _unseen(designs, y, labels, blocks)
    mean = {name: float(loss.mean()) for name, loss in losses.items()}
    gradual, abrupt = (min(names, key=mean.__getitem__) for names in (GRADUAL, ABRUPT))
    saved = losses[gradual] - losses[abrupt]
    times = resampled(blocks, RESAMPLES)
    per_block, sizes = np.bincount(labels, weights=saved), np.bincount(labels)
    low, high = percentiles((times @ per_block) / (times @ sizes))
    best, drawn = _where(designs[abrupt], y, labels, times)
    at = float(breaks[best])
    below, above = np.median(y[s < at]), np.median(y[s >= at])
    span = percentiles(breaks[drawn])
    worse = bool(below > above) and _bends_down(designs[abrupt][best], y, abrupt)
    better = bool(low is not None and low > 0)
    present = better and worse
    rise = float(10 ** (below - above))
    facts = (at, *span, rise, abrupt, gradual, float(saved.mean()), low, high)
    return Knee(present, _why(present, better, abrupt, gradual, at, rise), *facts)


def _why(present: bool, better: bool, abrupt: str, gradual: str, at: float, rise: float) -> str:
    if present:
        return f"knee at {at:.2f}: the median error below is {rise:.1f} times that above ({abrupt})"
    if better:
        return f"no knee: errors change at {at:.2f}, but do not rise faster below it"
    return f"no knee: a {gradual} predicts unseen errors as well as a break does"


def _designs(x: Array, breaks: Array) -> dict[str, list[Array]]:
    """The design matrices (K, P) of every model, one for every break of the abrupt ones."""
    one = np.ones_like(x)
    powers = [np.stack([x**d for d in range(degree + 1)], axis=1) for degree in range(4)]
    lines = [np.stack([one, np.minimum(x - t, 0), np.maximum(x - t, 0)], 1) for t in breaks]
    steps = [np.stack([x < t, x >= t], axis=1).astype(np.float64) for t in breaks]
    gradual = {name: [design] for name, design in zip(GRADUAL, powers, strict=True)}
    return gradual | {"step": steps, "two lines": lines}


def _unseen(
    designs: dict[str, list[Array]], y: Array, labels: NDArray[np.intp], blocks: int
) -> dict[str, Array]:
    """The squared error (K,) of every model for pairs whose blocks it has not seen."""
    fold = (np.arange(blocks) % min(FOLDS, blocks))[labels]
    losses = {name: np.zeros(len(y)) for name in designs}
    for name, several in designs.items():
        for k in np.unique(fold):
            out = fold == k
            fits = [_solve(d[~out], y[~out]) for d in several]
            inside = [
                float(((y[~out] - d[~out] @ b) ** 2).sum())
                for d, b in zip(several, fits, strict=True)
            ]
            best = int(np.argmin(inside))
            losses[name][out] = (y[out] - several[best][out] @ fits[best]) ** 2
    return losses


def _solve(design: Array, y: Array) -> Array:
    return np.asarray(np.linalg.lstsq(design, y, rcond=None)[0])


def _where(
    several: list[Array], y: Array, labels: NDArray[np.intp], times: Array
) -> tuple[int, NDArray[np.intp]]:
    """The break that fits best, and for every resample of the blocks (B,) its own.

    A block's pairs enter by their sums of products alone, so a resample is a weighted sum.
    """
    blocks = times.shape[1]
    residuals, drawn = list[Array](), list[Array]()
    for design in several:
        columns = design.shape[1]
        member = (labels[:, None] == np.arange(blocks)).astype(np.float64)
        XX = np.einsum("kb,ki,kj->bij", member, design, design, optimize=True)
        Xy = np.einsum("kb,ki,k->bi", member, design, y, optimize=True)
        yy = np.bincount(labels, weights=y * y, minlength=blocks)
        ridge = 1e-9 * np.eye(columns)
        for weights, out in ((np.ones((1, blocks)), residuals), (times, drawn)):
            A = np.tensordot(weights, XX, axes=1) + ridge
            b = weights @ Xy
            beta = np.linalg.solve(A, b[..., None])[..., 0]
            out.append(weights @ yy - (beta * b).sum(axis=1))
    best = int(np.argmin(np.stack(residuals)[:, 0]))
    return best, np.argmin(np.stack(drawn), axis=0)


def _bends_down(design: Array, y: Array, model: str) -> bool:
    """Whether errors rise faster below the break than above it, as the score falls."""
    beta = _solve(design, y)
    if model == "step":
        return bool(beta[0] > beta[1])
    return bool(beta[1] < 0 and beta[1] < beta[2])
