"""Perturbed copies of a data set: the replicates that tell a method's merit from a run's chance.

A copy has a little more range noise, odometry that errs a little differently, and starts a few
scans later. All is drawn from the seed, the data set's fingerprint and the copy's number alone, so
that every method sees the same copies. Beams are not dropped and time is not reversed: both ask
another question.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from rbtm_bench.core.geometry import inverse, rotation_angle, se2, translation_norm
from rbtm_bench.core.trajectory import orthonormalised
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import ATTRIBUTES, Dataset, Relations, beam_points
from rbtm_bench.datasets.noise_estimate import (
    OdometryError,
    moving,
    odometry_error,
    range_noise,
)

VERSION = "perturbed-1"
"""Part of the fingerprint: change it whenever the same draws give other scans."""

LARGEST = 3.0
"""Standard deviations at most of anything drawn: a copy is a neighbour, never an outlier."""
SHARE_OF_SCANS = 20
"""A copy leaves out at most one in so many scans, whatever ``start_scans`` says."""


@dataclass(frozen=True)
class Amounts:
    """``ranges``: noise as a share of the sensor's own; ``odometry``: jitter of the increments as
    a share of their error; ``start_scans``: scans after motion begins that may be left out."""

    ranges: float = 0.33
    odometry: float = 0.1
    start_scans: int = 10


def generator(*determined_by: Any) -> np.random.Generator:
    """Random numbers that depend on these words and numbers alone."""
    digest = hashlib.sha256(json.dumps(determined_by).encode()).digest()
    return np.random.default_rng(int.from_bytes(digest, "big"))


class Measured:
    """What the perturbations of a data set are measured by, found out when asked for."""

    def __init__(self, dataset: Dataset) -> None:
        self._dataset = dataset

    @cached_property
    def range_noise(self) -> float:
        """Standard deviation of a range, m."""
        return range_noise(self._dataset)

    @cached_property
    def odometry(self) -> Array | None:
        """The odometry (N, 4, 4)."""
        return self._poses[1]

    @cached_property
    def odometry_error(self) -> OdometryError | None:
        """The error of its increments; None without odometry."""
        stamps, odometry, truth = self._poses
        if odometry is None:
            return None
        return odometry_error(stamps, odometry, truth, self._dataset.relations)

    @cached_property
    def _poses(self) -> tuple[Array, Array | None, Array | None]:
        if not self._dataset.has_odometry:
            return np.zeros(0), None, None  # clouds: not worth reading them all
        unknown = np.full((4, 4), np.nan)
        rows = [
            (scan.stamp, scan.odometry, unknown if scan.ground_truth is None else scan.ground_truth)
            for scan in self._dataset
        ]
        stamps, odometry, truth = (np.array(column) for column in zip(*rows, strict=True))
        return stamps, odometry, truth if self._dataset.has_ground_truth else None

    @cached_property
    def begins(self) -> int:
        """The last scan before the first motion, by odometry or else by truth; 0 without both."""
        first: Array | None = None
        for index, scan in enumerate(self._dataset):
            pose = scan.ground_truth if scan.odometry is None else scan.odometry
            if pose is None:
                break
            first = pose if first is None else first
            if moving((inverse(first) @ pose)[None])[0]:
                return index - 1
        return 0

    def latest_start(self, amounts: Amounts) -> int:
        """The first scan that all copies have: what is scored begins there."""
        scans = len(self._dataset) - self.begins
        return self.begins + min(amounts.start_scans, scans // SHARE_OF_SCANS)


@lru_cache(maxsize=2)  # a data set and the same behind a cache
def measured(dataset: Dataset) -> Measured:
    """What a data set's copies have in common; kept of the last ones asked for."""
    return Measured(dataset)


class Since(Dataset):
    """A data set without its first scans."""

    def __init__(self, plain: Dataset, first: int) -> None:
        self.plain, self.first = plain, first
        for name in ATTRIBUTES:
            setattr(self, name, getattr(plain, name))

    def __len__(self) -> int:
        return len(self.plain) - self.first

    def __getitem__(self, index: int) -> Scan:
        if not 0 <= index < len(self):
            raise IndexError(f"scan {index} of {len(self)}")
        return replace(self.plain[index + self.first], index=index)

    def fingerprint(self) -> str:
        """sha256 of the data set's own and the number of scans left out."""
        return _digest(self.plain.fingerprint(), self.first)

    @property
    def relations(self) -> Relations | None:
        """All relations: those that begin before the first scan match no pose."""
        return self.plain.relations


class Perturbed(Since):
    """Replicate ``number`` (1, 2, ...) of a data set.

    Normal draws, cut at three standard deviations: on every range ``amounts.ranges`` times the
    sensor's estimated noise (along the ray, also of points without beams); on every increment of
    the odometry that moves ``amounts.odometry`` times its error. Increments are chained again, so
    the motion between two scans is that of all between, and its inverse. The first scan is drawn
    from those up to ``amounts.start_scans`` after motion begins; ``scored_from`` is the first one
    that all replicates have. ``draw`` records all of it (m, rad).
    """

    def __init__(self, plain: Dataset, seed: int, number: int, amounts: Amounts) -> None:
        common = measured(plain)
        self._words = (plain.fingerprint(), seed, number)
        latest = common.latest_start(amounts)
        first = int(generator(*self._words, "start").integers(common.begins, latest + 1))
        super().__init__(plain, first)
        self.scored_from = latest - first
        sensor = common.range_noise if amounts.ranges > 0 else 0.0
        self.sigma = amounts.ranges * sensor
        error = common.odometry_error if amounts.odometry > 0 else None
        self._odometry: Array | None = None
        if error is not None and common.odometry is not None:
            rng = generator(*self._words, "odometry")
            self._odometry = jittered(
                common.odometry[first:], error, amounts.odometry, self.planar, rng
            )
        self._amounts = amounts
        self.draw = {
            "number": number,
            "seed": seed,
            "of": self._words[0],
            "amounts": asdict(amounts),
            "sensor_noise_m": sensor,
            "range_noise_m": self.sigma,
            "odometry_error": None if error is None else asdict(error),
            "first_scan": first,
            "scored_from_scan": latest,
        }

    def __getitem__(self, index: int) -> Scan:
        scan = super().__getitem__(index)
        if self._odometry is not None:
            scan = replace(scan, odometry=self._odometry[index])
        if self.sigma > 0:
            scan = self._noisy(scan, generator(*self._words, "ranges", index + self.first))
        return scan

    def _noisy(self, scan: Scan, rng: np.random.Generator) -> Scan:
        """The scan with noise along its rays; a range stays a length."""
        if scan.ranges is None or scan.angles is None:
            noise = _bounded(rng, (len(scan.points), 1), self.sigma)
            ranges = np.linalg.norm(scan.points, axis=1, keepdims=True)
            factor = np.maximum(1.0 + noise / np.where(ranges > 0, ranges, 1.0), 0.5)
            return replace(scan, points=scan.points * factor)
        noise = _bounded(rng, scan.ranges.shape, self.sigma)
        ranges = np.maximum(scan.ranges + noise, 0.5 * scan.ranges)
        return replace(scan, ranges=ranges, points=beam_points(ranges, scan.angles))

    def fingerprint(self) -> str:
        """sha256 of the data set's own, the seed, the number and the amounts."""
        return _digest(VERSION, self._words, asdict(self._amounts))


def jittered(
    odometry: Array, error: OdometryError, share: float, planar: bool, rng: np.random.Generator
) -> Array:
    """Odometry (N, 4, 4) whose increments err by ``share`` of ``error`` more. The first
    pose stays."""
    steps = inverse(odometry[:-1]) @ odometry[1:]
    moves = moving(steps)
    shift = share * error.translation * translation_norm(steps)
    turn = share * np.hypot(error.rotation * rotation_angle(steps), error.rotation_rad)
    noise = _bounded(rng, (len(steps), 6), 1.0)
    noise[:, :3] *= (moves * shift)[:, None]
    noise[:, 3:] *= (moves * turn)[:, None]
    off = np.tile(np.eye(4), (len(steps), 1, 1))
    if planar:
        planar_motions = [se2(x, y, angle) for x, y, angle in noise[:, [0, 1, 5]]]
        off = np.reshape(planar_motions, off.shape)
    else:
        from scipy.spatial.transform import Rotation

        off[:, :3, :3] = Rotation.from_rotvec(noise[:, 3:]).as_matrix()
        off[:, :3, 3] = noise[:, :3]
    poses = [odometry[0]]
    for step, by in zip(steps, off, strict=True):
        poses.append(orthonormalised(poses[-1] @ step @ by))
    return np.stack(poses)


def _bounded(rng: np.random.Generator, shape: tuple[int, ...], sigma: float) -> Array:
    return sigma * np.clip(rng.standard_normal(shape), -LARGEST, LARGEST)


def _digest(*words: Any) -> str:
    return hashlib.sha256(json.dumps(words).encode()).hexdigest()
