"""Curvature made robust: a wider difference, an angle that wraps, optional lags.

phi lives modulo pi, so it is compared as u = exp(2i phi). With a half-span of several beams the
difference of two points is long against the range noise. See docs/similarity.md for what each
setting is for and what was measured.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.similarity.base import (
    BLOCK,
    Descriptor,
    PairwiseSimilarity,
    beam_spacing,
    require_beams,
)
from rbtm_bench.similarity.circular_sums import circular_sums
from rbtm_bench.similarity.inner import inner

NEGLIGIBLE_VARIANCE = 1e-9


class CurvatureCircular(PairwiseSimilarity):
    """Circular correlation of curvature angles over the beams that both scans have.

    With u_j = exp(2i phi_j) and the mean over shared beams, the score is
    ``max over lags L of f(mean(u_j[b + L] conj(u_k[b])))``, where a lag of L beams of spacing
    delta stands for a rotation by L delta and hence for a phase of 2 L delta:

    - ``lag_phase="consistent"``: f(z) = Re(exp(-2i L delta) z), the phase must fit the lag;
    - ``lag_phase="free"``: f(z) = |z|, any constant turn of the angles is forgiven.

    ``center=True`` removes the means and divides by the deviations, as equation (3) does.

    Parameters: ``half_span_deg`` of the difference, ``max_lag_deg`` (0: no lags),
    ``min_valid_share`` of beams that both scans must have, ``min_variance`` in [0, 1] of u over a
    scan's beams (1 - |mean u|^2). A scan below it (a bare wall) says nothing about place: its
    scores are NaN, as are those over too few shared beams.
    """

    def __init__(
        self,
        half_span_deg: Annotated[float, Gt(0), Le(45)] = 3.0,
        max_lag_deg: Annotated[float, Ge(0), Le(180)] = 0.0,
        lag_phase: Literal["consistent", "free"] = "free",
        center: bool = False,
        min_valid_share: Annotated[float, Ge(0), Le(1)] = 0.5,
        min_variance: Annotated[float, Ge(0), Le(1)] = 0.05,
    ) -> None:
        self.half_span_deg = half_span_deg
        self.max_lag_deg = max_lag_deg
        self.lag_phase = lag_phase
        self.center = center
        self.min_valid_share = min_valid_share
        self.min_variance = min_variance
        self._spacing: float | None = None
        self._geometry: tuple[Array, tuple[int, Array, Array]] | None = None

    def check(self, dataset: Dataset) -> None:
        require_beams(dataset, "curvature_circular")

    def describe(self, scan: Scan) -> Array:
        """(3 B',) real: Re u, Im u and the mask of the B' = B - 2h beams; 0 where undefined."""
        assert scan.ranges is not None and scan.angles is not None
        return self.describe_beams(scan.ranges, scan.angles)

    def describe_beams(self, ranges: Array, angles: Array) -> Array:
        """As ``describe``, of beams (..., B) in m (NaN: no return) at evenly spaced angles (B,)."""
        h, cosine, sine = self._beams(angles)
        x, y = ranges * cosine, ranges * sine
        dx, dy = x[..., 2 * h :] - x[..., : -2 * h], y[..., 2 * h :] - y[..., : -2 * h]
        # exp(2i phi) without a trigonometric function: ((dx^2 - dy^2) + 2i dx dy) / (dx^2 + dy^2)
        square = dx * dx + dy * dy
        known = square > 0.0  # False for NaN
        square = np.where(known, square, np.inf)
        real = np.where(known, dx * dx - dy * dy, 0.0) / square
        imag = np.where(known, 2.0 * dx * dy, 0.0) / square
        count = np.maximum(1, np.count_nonzero(known, axis=-1))
        # rounding makes the variance of a perfect wall -1e-16: min_variance=0 must let it pass
        mean_square = (real.sum(axis=-1) ** 2 + imag.sum(axis=-1) ** 2) / count**2
        descriptor = np.concatenate([real, imag, known], axis=-1)
        descriptor[np.maximum(0.0, 1.0 - mean_square) < self.min_variance] = 0.0
        return descriptor

    def curve(self, descriptor: Descriptor) -> tuple[str, Array]:
        """phi of u = exp(2i phi), in deg: modulo 180."""
        real, imag, known = descriptor.reshape(3, -1)
        return "phi (deg)", np.where(known > 0, np.degrees(np.arctan2(imag, real)) / 2, np.nan)

    def describe_all(self, scans: Sequence[Scan]) -> Array:
        angles = scans[0].angles
        if angles is None or any(
            scan.angles is not angles or scan.ranges is None for scan in scans
        ):
            return super().describe_all(scans)
        return self.describe_beams(np.stack([scan.ranges for scan in scans]), angles)  # type: ignore[misc]

    def pair_scores(self, rows: Descriptor, columns: Descriptor) -> Array:
        if self.center:
            return self._best_lag(rows, columns, lambda c: self._centred(rows, c))
        shape = np.broadcast_shapes(rows.shape, columns.shape)
        first, second = (np.broadcast_to(d, shape).reshape(-1, shape[-1]) for d in (rows, columns))
        scores = self._runs(first, second, np.arange(len(first)), 1)
        return scores.reshape(shape[:-1])

    def scores(self, window: Descriptor, descriptor: Descriptor) -> Array:
        if not self._in_runs:
            return super().scores(window, descriptor)
        return self._runs(window, descriptor[None], np.zeros(1, np.int64), len(window))[0]

    def pairwise(self, rows: Descriptor, columns: Descriptor) -> Array:
        if not self._in_runs:
            return super().pairwise(rows, columns)
        return self._runs(rows, columns, np.zeros(len(columns), np.int64), len(rows)).T

    def band(self, descriptors: Descriptor, window: int, first: int = 0) -> Array:
        if not self._in_runs:
            return super().band(descriptors, window, first)
        width, count = window - 1, len(descriptors)
        band = np.full((count - first, width), np.nan)
        for j in range(max(1, first), min(width, count)):
            band[j - first, :j] = self.scores(descriptors[:j], descriptors[j])[::-1]
        for start in range(max(width, first), count, BLOCK):
            now = np.arange(start, min(start + BLOCK, count))
            scores = self._runs(descriptors, descriptors[now], now - width, width)
            band[now - first] = scores[:, ::-1]
        return band

    @property
    def _in_runs(self) -> bool:
        """Whether one kernel gives all scores: not centred ones, nor another class's idea of a
        pair."""
        return not self.center and type(self).pair_scores is CurvatureCircular.pair_scores

    def _runs(
        self, rows: Descriptor, columns: Descriptor, first: NDArray[np.int64], count: int
    ) -> Array:
        """Scores (C, count) of columns (C, D) with ``count`` rows from ``first`` (C,) on."""
        rows, columns = np.ascontiguousarray(rows), np.ascontiguousarray(columns)

        def mean(shifted: Descriptor) -> tuple[Array, Array, Array]:
            sums = circular_sums(rows, shifted, first, count)
            shared = sums[..., 0]
            with np.errstate(divide="ignore", invalid="ignore"):
                return shared, sums[..., 1] / shared, sums[..., 2] / shared

        return self._best_lag(rows, columns, mean)

    def _best_lag(self, rows: Descriptor, columns: Descriptor, mean: Callable[..., Any]) -> Array:
        """The best score over lags of what ``mean`` gives for shifted columns: shared beams, and
        the real and imaginary part of the mean of u conj(v) over them."""
        beams = rows.shape[-1] // 3
        scores = []
        for lag in self._lags():  # beam b + lag of the row meets beam b of the column
            shared, real, imag = mean(_shift(columns, lag, beams))
            if self.lag_phase == "consistent":
                phase = 2.0 * lag * (self._spacing or 0.0)
                score = np.cos(phase) * real + np.sin(phase) * imag
            else:
                score = np.hypot(real, imag)
            enough = shared >= max(1.0, self.min_valid_share * beams)
            scores.append(np.where(enough, np.clip(score, -1.0, 1.0), np.nan))
        return functools.reduce(np.fmax, scores)

    @staticmethod
    def _centred(rows: Descriptor, columns: Descriptor) -> tuple[Array, Array, Array]:
        beams = rows.shape[-1] // 3
        a, b, m = (columns[..., k * beams : (k + 1) * beams] for k in range(3))
        shared = inner(rows[..., 2 * beams :], m)
        real = inner(rows[..., : 2 * beams], columns[..., : 2 * beams])
        imag = inner(rows[..., beams : 2 * beams], a) - inner(rows[..., :beams], b)
        with np.errstate(divide="ignore", invalid="ignore"):
            z = real / shared + 1j * (imag / shared)
            return shared, *_centred(z, rows, columns, shared, beams)

    def _lags(self) -> range:
        most = round(np.radians(self.max_lag_deg) / abs(self._spacing)) if self._spacing else 0
        return range(-most, most + 1)

    def _beams(self, angles: Array) -> tuple[int, Array, Array]:
        """The half-span in beams, and the beams' directions; computed when the angles change."""
        if self._geometry is None or self._geometry[0] is not angles:
            h = self._half_span_beams(angles)
            self._geometry = (angles, (h, np.cos(angles), np.sin(angles)))
        return self._geometry[1]

    def _half_span_beams(self, angles: Array) -> int:
        self._spacing = beam_spacing(angles, self._spacing, "curvature_circular")
        h = max(1, round(np.radians(self.half_span_deg) / abs(self._spacing)))
        if 2 * h >= len(angles):
            raise ConfigError(
                f"similarity.half_span_deg={self.half_span_deg} spans {2 * h} of "
                f"{len(angles)} beams: expected a smaller angle"
            )
        return h


def _shift(columns: Descriptor, lag: int, beams: int) -> Descriptor:
    """Each of the three parts moved up by ``lag`` beams, zeros (no return) coming in."""
    if lag == 0:
        return columns
    parts = columns.reshape(*columns.shape[:-1], 3, beams)
    out = np.zeros_like(parts)
    if lag > 0:
        out[..., lag:] = parts[..., :-lag]
    else:
        out[..., :lag] = parts[..., -lag:]
    return out.reshape(columns.shape)


def _centred(
    z: Array, rows: Descriptor, columns: Descriptor, shared: Array, beams: int
) -> tuple[Array, Array]:
    """The complex correlation coefficient (real, imaginary) from z = mean(u conj v): |u| = |v| = 1
    on shared beams, so each variance is 1 - |mean|^2."""
    m_rows, m_cols = rows[..., 2 * beams :], columns[..., 2 * beams :]
    first, second = slice(0, beams), slice(beams, 2 * beams)
    mean_u = inner(rows[..., first], m_cols) + 1j * inner(rows[..., second], m_cols)
    mean_v = inner(m_rows, columns[..., first]) + 1j * inner(m_rows, columns[..., second])
    mean_u, mean_v = mean_u / shared, mean_v / shared
    variance = (1.0 - np.abs(mean_u) ** 2) * (1.0 - np.abs(mean_v) ** 2)
    variance = np.where(variance > NEGLIGIBLE_VARIANCE, variance, np.nan)
    centred = (z - mean_u * np.conj(mean_v)) / np.sqrt(variance)
    return centred.real, centred.imag
