"""The scores of all pairs of a data set's scans, or of a band of them, within a bound of memory."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.files import write_atomically
from rbtm_bench.core.geometry import inverse, translation_norm
from rbtm_bench.core.types import Array
from rbtm_bench.similarity.base import Descriptor, Similarity

if TYPE_CHECKING:
    from rbtm_bench.datasets.base import Dataset

Progress = Callable[[int, int, str], None]

BLOCK = 256
"""Scans on a side of a block, at most."""
COPIES = 4
"""A block's work may take so many arrays as large as all its pairs' descriptors."""
FOR_BLOCKS = 0.25
"""Share of the memory that blocks and descriptors may take beside the scores, at least 50 MB."""
LEAST_BLOCK_MB = 50.0


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of N scans: (N, N) float32 with ``window`` None, row j the new scan, column k its
    model; else (N, window - 1), column g - 1 scan j with scan j - g. NaN where undefined or
    without such a scan. ``stamps`` (N,) s; ``metres`` (N,) travelled, None where not known;
    ``guess`` says which motions a similarity that needs them was given."""

    scores: NDArray[np.float32]
    stamps: Array
    metres: Array | None
    window: int | None
    guess: str = ""

    @property
    def widest(self) -> int:
        """Gaps below this have scores."""
        count = len(self.scores)
        return count if self.window is None else min(self.window, count)

    def at_gap(self, gap: int) -> NDArray[np.float32]:
        """The scores of all scans with the scan ``gap`` before."""
        if self.window is None:
            return np.diagonal(self.scores, -gap)
        return self.scores[gap:, gap - 1]

    @property
    def undefined_share(self) -> float:
        """The share of undefined scores among the pairs that exist."""
        if self.window is None:
            missing = sum(int(np.isnan(row).sum()) for row in self.scores)
            return missing / max(1, self.scores.size)
        columns = [self.at_gap(g) for g in range(1, self.widest)]
        return sum(int(np.isnan(c).sum()) for c in columns) / max(1, sum(map(len, columns)))

    def write(self, path: Path, config: Mapping[str, Any]) -> None:
        """A numpy archive with the settings, not compressed: scores would not get smaller."""
        metres: dict[str, Any] = {} if self.metres is None else {"metres": self.metres}

        def save(partial: Path) -> None:
            with open(partial, "wb") as file:
                np.savez(
                    file,
                    scores=self.scores,
                    scans=np.arange(len(self.scores)),
                    stamps=self.stamps,
                    settings=np.array(json.dumps(config)),
                    **metres,
                )

        write_atomically(path, save)


def refuse_too_large(
    count: int,
    window: int | None,
    memory_mb: float,
    stride: int | None = None,
    descriptor_bytes: int = 0,
) -> None:
    """Raise ``ConfigError`` with what to do if so many scans do not fit: their scores, their
    descriptors, and what a block's work may take.

    ``stride`` is the data set's own setting, None if it has none.
    """
    columns = count if window is None else window - 1
    room = memory_mb - max(LEAST_BLOCK_MB, FOR_BLOCKS * memory_mb)
    scores, described = 4e-6 * count * columns, 1e-6 * count * descriptor_bytes
    needed = scores + described
    if needed <= room:
        return
    whole = needed + max(LEAST_BLOCK_MB, needed * FOR_BLOCKS / (1 - FOR_BLOCKS))
    what = f"{count} x {columns} scores need about --memory {np.ceil(whole):.0f} (MB)"
    if window is not None:
        raise ConfigError(f"{what}, {memory_mb:g} are allowed: a smaller selector.window, or more")
    thin = ""
    if stride is not None and room > 0:
        # scores shrink with the square of it, descriptors with it
        every = (described + np.sqrt(described**2 + 4 * room * scores)) / (2 * room)
        thin = f", or dataset.stride={stride * int(np.ceil(every))}"
    raise ConfigError(f"{what}, {memory_mb:g} are allowed: use --band selector.window=W{thin}")


def compute(
    dataset: Dataset,
    similarity: Similarity,
    window: int | None,
    memory_mb: float,
    progress: Progress | None = None,
    stride: int | None = None,
) -> Scores:
    """All scores of a data set, block by block. Memory: the scores, all descriptors, a block.

    Raises ``ConfigError`` before anything is computed if that is more than ``memory_mb``.
    """
    tell = progress or (lambda done, total, note: None)
    if len(dataset):
        size = similarity.describe(dataset[0].without_truth()).nbytes
        refuse_too_large(len(dataset), window, memory_mb, stride, size)
    described, stamps, poses = _described(dataset, similarity, tell)
    guess = ""
    odometry: Array | None = None
    if similarity.needs_guess:
        guess = "no motion"
        if dataset.has_odometry:
            odometry, guess = poses, "odometry between the two scans (far pairs: off by its drift)"
    if window is None:
        scores = _matrix(similarity, described, odometry, memory_mb, tell)
    else:
        scores = _band(similarity, described, odometry, window, tell)
    return Scores(scores, stamps, _travelled(poses), window, guess)


def _described(
    dataset: Dataset, similarity: Similarity, tell: Progress
) -> tuple[Descriptor, Array, Array | None]:
    """Descriptors (N, D), stamps (N,) and the poses (N, 4, 4) that distances are measured by."""
    count = len(dataset)
    descriptors: Descriptor | None = None
    stamps = np.zeros(count)
    poses = np.full((count, 4, 4), np.nan)
    for i, scan in enumerate(dataset):
        one = similarity.describe(scan.without_truth())
        if descriptors is None:
            descriptors = np.zeros((count, len(one)), one.dtype)
        descriptors[i], stamps[i] = one, scan.stamp
        pose = scan.odometry if dataset.has_odometry else scan.ground_truth
        if pose is not None:
            poses[i] = pose
        tell(i + 1, count, "describing")
    if descriptors is None:
        raise ConfigError("the data set has no scan")
    return descriptors, stamps, poses if np.isfinite(poses).any() else None


def _travelled(poses: Array | None) -> Array | None:
    if poses is None:
        return None
    steps = translation_norm(inverse(poses[:-1]) @ poses[1:])
    return np.concatenate([[0.0], np.cumsum(np.nan_to_num(steps))])


def _matrix(
    similarity: Similarity,
    described: Descriptor,
    odometry: Array | None,
    memory_mb: float,
    tell: Progress,
) -> NDArray[np.float32]:
    count = len(described)
    scores = np.empty((count, count), np.float32)
    side = block_side(described, memory_mb)
    for first in range(0, count, side):
        models = slice(first, min(first + side, count))
        for start in range(0, count, side):
            new = slice(start, min(start + side, count))
            if similarity.needs_guess:
                for j in range(new.start, new.stop):
                    motions = _motions(odometry, models, j)
                    under = similarity.scores_under(described[models], described[j], motions)
                    scores[j, models] = under
            else:
                scores[new, models] = similarity.pairwise(described[models], described[new]).T
        tell(models.stop, count, "scores")
    return scores


def block_side(described: Descriptor, memory_mb: float) -> int:
    """Scans on a side of a block whose work fits, however a similarity writes it: at worst with
    arrays of all its pairs' descriptors."""
    room = 1e6 * max(LEAST_BLOCK_MB, FOR_BLOCKS * memory_mb)
    a_pair = COPIES * max(1, described[0].nbytes)
    return int(np.clip(np.sqrt(room / a_pair), 1, BLOCK))


def _band(
    similarity: Similarity,
    described: Descriptor,
    odometry: Array | None,
    window: int,
    tell: Progress,
) -> NDArray[np.float32]:
    count = len(described)
    scores = np.full((count, window - 1), np.nan, np.float32)
    for first in range(0, count, BLOCK):
        stop = min(first + BLOCK, count)
        since = max(0, first - window + 1)
        if similarity.needs_guess:
            for j in range(max(first, 1), stop):
                past = slice(max(0, j - window + 1), j)
                motions = _motions(odometry, past, j)
                under = similarity.scores_under(described[past], described[j], motions)
                scores[j, : past.stop - past.start] = under[::-1]
        else:
            scores[first:stop] = similarity.band(described[since:stop], window)[first - since :]
        tell(stop, count, "scores")
    return scores


def _motions(odometry: Array | None, models: slice, j: int) -> Array:
    """T_model_scan (W, 4, 4) of scan j from each of the models: by odometry, else no motion."""
    if odometry is None:
        return np.tile(np.eye(4), (models.stop - models.start, 1, 1))
    return np.asarray(inverse(odometry[models]) @ odometry[j])
