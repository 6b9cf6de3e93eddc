"""Data sets made worse on purpose (``perturb``): lost and false returns, movers, thinner or biased.

Unlike replicates (``perturbed``), which stay close to the data, this asks how much a method bears.
Every effect has random numbers of its own, drawn from the seed, the data set's fingerprint and the
scan alone: a larger share keeps what a smaller one did, and one effect leaves the others as
they are.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.geometry import inverse, se2, translation_norm
from rbtm_bench.core.trajectory import orthonormalised
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import ATTRIBUTES, Dataset, Reading, Relations, beam_points
from rbtm_bench.datasets.movers import PASS, Pass
from rbtm_bench.datasets.perturbed import generator, measured

VERSION = "degraded-1"
"""Part of the fingerprint: change it whenever the same settings give other scans."""

SECTORS = 180
"""Blocked bearings come in sectors of 2 deg, as dirt on a window does."""
NEAREST = 0.05
"""An outlier lies between this share of the scan's longest range and all of it."""
MOST_RINGS, RING_DEG, BAND_DEG = 128, 0.02, 0.5
"""Elevations that agree to 0.02 deg are a ring; more than 128 are none, and bands are counted."""


OF_RAYS = {"dropout", "outliers", "blocked", "movers", "every_beam"}


@dataclass(frozen=True)
class Degradation:
    """How much worse, each by itself; as they stand here nothing is.

    ``dropout`` and ``outliers``: shares of the returns that are lost, or come from anywhere
    along their ray; ``blocked``: share of the bearings (sectors of 2 deg) that nothing returns
    from, the whole drive long; ``movers``: upright cylinders that cross at a walk;
    ``first_scan`` and ``end_scan``: the part of the drive from the one to before the other;
    ``every_scan`` and ``every_beam``: keep one in so many (clouds: of the rings);
    ``odometry_scale``: share that odometry is too long by; ``odometry_drift_deg``: that it turns
    left by on every metre (deg).
    """

    dropout: float = 0.0
    outliers: float = 0.0
    blocked: float = 0.0
    movers: int = 0
    first_scan: int = 0
    end_scan: int | None = None
    every_scan: int = 1
    every_beam: int = 1
    odometry_scale: float = 0.0
    odometry_drift_deg: float = 0.0

    def changed(self) -> dict[str, float]:
        """What is not as it is without."""
        return {
            f.name: value for f in fields(self) if (value := getattr(self, f.name)) != f.default
        }


class Degraded(Dataset):
    """A data set with ``by`` done to it, drawn from ``seed``; truth, times and relations stay.

    Raises ``ConfigError`` where odometry is to be biased and there is none, or where fewer than
    two scans would be left.
    """

    def __init__(self, plain: Dataset, by: Degradation, seed: int) -> None:
        self.plain, self.by = plain, by
        self._words = (plain.fingerprint(), seed)
        for name in ATTRIBUTES:
            setattr(self, name, getattr(plain, name))
        for key in ("odometry_scale", "odometry_drift_deg"):
            if key in by.changed() and not plain.has_odometry:
                raise ConfigError(f"perturb.{key}={by.changed()[key]:g}: the data have no odometry")
        if by.changed().keys() & {"first_scan", "end_scan", "every_scan"} and len(self) < 2:
            words = ", ".join(f"perturb.{key}={value:g}" for key, value in by.changed().items())
            raise ConfigError(f"{words}: there are {len(plain)} scans")
        self.scored_from = -(-max(plain.scored_from - by.first_scan, 0) // by.every_scan)
        words = ", ".join(f"{key} {value:g}" for key, value in by.changed().items())
        self.readings = (*plain.readings, Reading("perturbed", words, "as asked for", "perturb."))
        self._pass = lru_cache(maxsize=2)(self._new_pass)

    def __len__(self) -> int:
        end = len(self.plain) if self.by.end_scan is None else self.by.end_scan
        return max(0, -(-(min(end, len(self.plain)) - self.by.first_scan) // self.by.every_scan))

    def __getitem__(self, index: int) -> Scan:
        if not 0 <= index < len(self):
            raise IndexError(f"scan {index} of {len(self)}")
        at = self.by.first_scan + index * self.by.every_scan
        scan = replace(self.plain[at], index=index)
        if self._odometry is not None:
            scan = replace(scan, odometry=self._odometry[at])
        if (
            not {"dropout", "outliers", "blocked", "movers", "every_beam"}
            & self.by.changed().keys()
        ):
            return scan
        if scan.ranges is not None and scan.angles is not None:
            return self._of_beams(scan, scan.ranges, scan.angles, at)
        return self._of_cloud(scan, at)

    def _of_beams(self, scan: Scan, ranges: Array, angles: Array, at: int) -> Scan:
        rays = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])
        kept = np.arange(len(angles)) % self.by.every_beam == 0
        now = self._measured(scan, rays, ranges, at)[kept]
        times = scan.times
        if times is not None:  # a mover may be seen by beams that had no return, hence no time
            hit = np.flatnonzero(np.isfinite(ranges))
            of_all = np.interp(np.arange(len(angles)), hit, times) if len(hit) else 0.0 * angles
            times = of_all[kept][np.isfinite(now)]
        points = beam_points(now, angles[kept])
        return replace(scan, ranges=now, angles=angles[kept], points=points, times=times)

    def _of_cloud(self, scan: Scan, at: int) -> Scan:
        ranges = np.linalg.norm(scan.points, axis=1)
        length = np.where(ranges > 0, ranges, 1.0)
        rays = scan.points / length[:, None]
        now = self._measured(scan, rays, ranges, at)
        kept = np.isfinite(now)
        if self.by.every_beam > 1:
            kept &= self._ring(rays) % self.by.every_beam == 0
        factor = np.where(ranges > 0, now / length, 1.0)[kept]  # 1 exactly where nothing happened
        times = None if scan.times is None else scan.times[kept]
        return replace(scan, points=scan.points[kept] * factor[:, None], times=times)

    def _measured(self, scan: Scan, rays: Array, ranges: Array, at: int) -> Array:
        """The ranges (N,) m along unit rays (N, 3), NaN for none."""
        by, now = self.by, np.array(ranges)
        known = now[np.isfinite(now)]
        reach = float(known.max()) if len(known) else 0.0
        if by.movers:
            seen = self._pass(at // PASS).ranges(scan, rays)
            nearer = (seen < now) | (np.isnan(now) & (seen <= reach))
            now[nearer] = seen[nearer]
        if by.outliers > 0:
            chosen, where = self._rng("outliers", at).random((2, len(now)))
            false = (chosen < by.outliers) & np.isfinite(now)
            now[false] = reach * (NEAREST + (1.0 - NEAREST) * where[false])
        if by.dropout > 0:
            now[self._rng("dropout", at).random(len(now)) < by.dropout] = np.nan
        if by.blocked > 0:
            bearing = np.arctan2(rays[:, 1], rays[:, 0]) / (2.0 * np.pi) + 0.5
            sector = np.minimum((bearing * SECTORS).astype(int), SECTORS - 1)
            now[self._blocked[sector]] = np.nan
        return now

    @cached_property
    def _blocked(self) -> NDArray[np.bool_]:
        """Of every sector whether it is blocked."""
        return np.asarray(self._rng("blocked").random(SECTORS) < self.by.blocked)

    @cached_property
    def _rings(self) -> Array | None:
        """The elevations (R,) rad of the first scan's rings; None if there are none to tell."""
        found = np.unique(np.round(np.rad2deg(_elevation(self.plain[0].points)) / RING_DEG))
        apart = found[np.diff(found, prepend=-np.inf) > 1.5]
        return np.deg2rad(apart * RING_DEG) if 1 < len(apart) <= MOST_RINGS else None

    def _ring(self, rays: Array) -> NDArray[np.int64]:
        """The number (N,) of every ray's ring, or of its band of 0.5 deg."""
        elevation = _elevation(rays)
        if self._rings is None:
            return np.floor(np.rad2deg(elevation) / BAND_DEG).astype(np.int64)
        between = 0.5 * (self._rings[1:] + self._rings[:-1])
        return np.searchsorted(between, elevation).astype(np.int64)

    @cached_property
    def _odometry(self) -> Array | None:
        """The biased odometry of every scan of the plain data set; None: as it is."""
        scale, drift = self.by.odometry_scale, float(np.deg2rad(self.by.odometry_drift_deg))
        odometry = measured(self.plain).odometry if scale or drift else None
        return None if odometry is None else biased(odometry, scale, drift)

    def _new_pass(self, number: int) -> Pass:
        rngs = [self._rng("movers", number, mover) for mover in range(self.by.movers)]
        first = number * PASS
        last = min(first + PASS, len(self.plain)) - 1
        return Pass(self.plain[first], self.plain[last].stamp, rngs)

    def _rng(self, *words: Any) -> np.random.Generator:
        return generator(*self._words, *words)

    def fingerprint(self) -> str:
        """sha256 of the data set's own, the seed and what is done to it."""
        words = [VERSION, self._words, asdict(self.by)]
        return hashlib.sha256(json.dumps(words).encode()).hexdigest()

    @property
    def relations(self) -> Relations | None:
        """All relations: those between scans that are left out match no pose."""
        return self.plain.relations


def degraded(plain: Dataset, by: Degradation, seed: int) -> Dataset:
    """The data set itself where nothing is to be done to it."""
    return Degraded(plain, by, seed) if by.changed() else plain


def biased(odometry: Array, scale: float, drift: float) -> Array:
    """Odometry (N, 4, 4) whose increments are too long by the share ``scale`` and turn left by
    ``drift`` (rad) more on every metre. The first pose stays."""
    steps = inverse(odometry[:-1]) @ odometry[1:]
    turns = drift * translation_norm(steps)
    steps[:, :3, 3] *= 1.0 + scale
    poses = [odometry[0]]
    for step, turn in zip(steps, turns, strict=True):
        poses.append(orthonormalised(poses[-1] @ step @ se2(0.0, 0.0, float(turn))))
    return np.stack(poses)


def _elevation(points: Array) -> Array:
    return np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
