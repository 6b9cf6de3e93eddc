"""Which settings are worth running: those that pairs predict to drift least.

Fixed gaps and keyframes are predicted by the pairs of one gap, RBTM by those that it would choose.
Where the spread of a gap's errors may be the truth's own, nothing can be predicted; of such gaps
some are run as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.calibration.drift import PairErrors, drift, noise_drift
from rbtm_bench.calibration.measuring import SIGNED
from rbtm_bench.calibration.parts import CALIBRATION
from rbtm_bench.calibration.sampling import GAP, Sample
from rbtm_bench.core.geometry import inverse, translation_norm
from rbtm_bench.core.types import Array
from rbtm_bench.report.intervals import Interval

if TYPE_CHECKING:
    import pandas as pd

    from rbtm_bench.calibration.analysis import Measured

THRESHOLDS = 6
"""Thresholds that are looked at: between quantiles of the scores."""
KEYFRAMES, GAPS, RBTM = 3, 1, 2
"""How many settings of a strategy are run."""
FEWEST_PAIRS = 10
"""Of a gap, below which nothing is predicted."""
LEAST_USE = 0.05
"""A threshold must choose for this share of the scans at least, and refuse the oldest of it."""
APART = 1.5
"""Gaps or windows of settings that are run differ by this factor."""


@dataclass(frozen=True)
class Candidate:
    """A setting that is run: its name, the words that choose it, and what it is predicted to drift
    (m; None for a reference) with a mean ``gap``. ``unsure``: why that says nothing."""

    name: str
    words: tuple[str, ...]
    gap: float | None = None
    drift: Interval | None = None
    unsure: str = ""
    similarity: str = ""
    """The label of the one that it chooses by; "": it needs none."""
    reference: bool = False


REFERENCES = (
    Candidate("keyframe, default", ("selector=keyframe",), reference=True),
    Candidate("previous", ("selector=previous",), reference=True),
    Candidate("rbtm, default", ("selector=rbtm",), reference=True),
)
"""In the order that they are preferred in where nothing tells them apart."""


@dataclass(frozen=True, eq=False)
class Gap:
    """The pairs of a gap: how many, their errors, the drift that they predict."""

    gap: int
    pairs: int
    errors: PairErrors
    links: float
    drift: Interval
    unsure: str = ""


class Shortlist:
    """What the calibration part's pairs say of a backend's settings on a path (N, 4, 4)."""

    def __init__(self, measured: Measured, backend: str, samples: Sequence[Sample]) -> None:
        pairs = measured.pairs
        self._measured = measured
        self._inside = ((pairs["kind"] == GAP) & (pairs["part"] == CALIBRATION)).to_numpy()
        self._rows = pairs[self._inside].reset_index(drop=True)
        self._outcome = measured.outcomes[backend][self._inside].reset_index(drop=True)
        sample = samples[0]
        path = np.zeros((0, 4, 4)) if sample.path is None else sample.path[sample.part == 0]
        self.path = path[np.isfinite(path).all(axis=(1, 2))]
        self._exact = all(s.conditions["exact"] for s in samples)
        self.gaps = self._judged(list(self._of_gaps())) if len(self.path) > 1 else []

    def candidates(self) -> list[Candidate]:
        """Keyframes, a fixed gap and RBTM, the most promising of each."""
        tried = spread_out(self.gaps)
        by_keyframe = [self._keyframe(gap) for gap in tried[:KEYFRAMES]]
        kept = {c.words: c for c in by_keyframe if c is not None}
        fixed = [
            Candidate(
                f"fixed gap {g.gap}",
                ("selector=fixed_gap", f"selector.gap={g.gap}"), g.gap, g.drift, g.unsure,
            )
            for g in [g for g in tried if g.gap > 1][:GAPS]
        ]  # fmt: skip
        return [*kept.values(), *fixed, *self._rbtm()]

    def _of_gaps(self) -> Iterator[Gap]:
        groups = self._rows["group"].to_numpy()
        for group in np.unique(groups):
            some = groups == group
            if some.sum() >= FEWEST_PAIRS:
                errors = self._errors(some.astype(np.float64))
                gap = int(np.median(self._rows["gap"][some]))
                links = float(np.maximum(self._rows["links"][some], 1).mean())
                yield Gap(gap, int(some.sum()), errors, links, drift(errors, self.path, gap))

    def _errors(self, weight: Array) -> PairErrors:
        used = weight > 0
        e = self._outcome.loc[used, list(SIGNED)].to_numpy(np.float64)
        blocks = self._rows["cluster"].to_numpy(np.intp)[used]
        return PairErrors(e[:, :3], np.radians(e[:, 3:]), blocks, weight[used])

    def _judged(self, gaps: list[Gap]) -> list[Gap]:
        """The gaps, with what cannot be predicted: where an error of the truth as large as the
        least spread of any gap (of one relation) would make half of the drift's square."""
        if self._exact or not gaps:
            return gaps
        spreads = np.array([np.array(g.errors.spread) / g.links**0.5 for g in gaps])
        m, rad = spreads.min(axis=0)
        length = float(translation_norm(inverse(self.path[:-1]) @ self.path[1:]).sum())
        judged = []
        for g in gaps:
            times = g.links * len(self.path) / g.gap
            least = noise_drift((m, rad), times, length, g.drift.n)
            words = (
                f"errors of the truth of {m:.3f} m, {np.degrees(rad):.2g} deg would look the same"
            )
            judged.append(replace(g, unsure=words if 2 * least**2 >= g.drift.value**2 else ""))
        return judged

    def _keyframe(self, gap: Gap) -> Candidate | None:
        """A keyframe as far as the robot drives in so many scans, when it drives."""
        step = translation_norm(inverse(self.path[: -gap.gap]) @ self.path[gap.gap :])
        driven = step[step > 0.5 * np.quantile(step, 0.9)]
        distance = float(f"{np.median(driven):.2g}") if len(driven) else 0.0
        if distance <= 0:
            return None
        words = ("selector=keyframe", f"selector.distance={distance:g}")
        return Candidate(f"keyframe {distance:g} m", words, gap.gap, gap.drift, gap.unsure)

    def _rbtm(self) -> Iterator[Candidate]:
        """The settings of RBTM with the least drift, windows apart."""
        for name in self._measured.scores:
            ranked = sorted(self._of_thresholds(name), key=lambda c: c[1].drift.value)  # type: ignore[union-attr]
            windows: list[int] = []
            for window, candidate in ranked:
                if len(windows) < RBTM and all(_apart(window, w) for w in windows):
                    windows.append(window)
                    yield candidate

    def _of_thresholds(self, similarity: str) -> Iterator[tuple[int, Candidate]]:
        score = self._measured.scores[similarity][self._inside]
        offered = self._offered(similarity)
        known = {int(g): n for g, n in self._rows["group"].value_counts().items()}
        groups = np.array([g for g in offered.columns if known.get(int(g), 0) >= FEWEST_PAIRS])
        defined = score[np.isfinite(score)]
        if not len(groups) or not len(defined) or not self.gaps:
            return
        table = offered[list(groups)].to_numpy(np.float64)
        ends = np.quantile(defined, np.linspace(0, 0.9, THRESHOLDS))
        for threshold in np.unique(ends.round(3)):
            for window in groups[1:] + 1:
                made = self._setting(
                    similarity, score, table, groups, float(threshold), int(window)
                )
                if made is not None:
                    yield int(window), made

    def _offered(self, similarity: str) -> pd.DataFrame:
        """The scores of what windows offer: a row a scan, a column a group of gaps."""
        windows, scores = self._measured.windows, self._measured.offered[similarity]
        table = windows.assign(score=scores)[windows["part"] == CALIBRATION]
        return table.set_index(["data", "source", "group"])["score"].unstack("group")

    def _setting(
        self,
        similarity: str,
        score: Array,
        offered: Array,
        groups: NDArray[np.intp],
        threshold: float,
        window: int,
    ) -> Candidate | None:
        choice = choices(offered, threshold, groups < window)
        used = choice >= 0
        undecided = choices(offered, -np.inf, groups < window)
        if used.mean() < LEAST_USE or (choice == undecided).mean() > 1 - LEAST_USE:
            return None  # it is the fallback, or a fixed gap
        mine = self._rows["group"].to_numpy()
        weight = np.zeros(len(mine))
        for k, group in enumerate(groups):
            pairs = (mine == group) & (score > threshold)
            share = float((choice == k).mean())
            if share and not pairs.any():
                return None
            weight[pairs] += share / max(pairs.sum(), 1)
        first = mine == groups[0]  # the fallback takes the scan before
        weight[first] += float((~used).mean()) / first.sum()
        gap = float(np.where(used, groups[choice], groups[0]).mean())
        words = ("selector=rbtm", f"selector.threshold={threshold:g}", f"selector.window={window}")
        name = f"rbtm {threshold:g}, window {window}"
        label = f"{name}, {similarity}" if len(self._measured.scores) > 1 else name
        predicted = drift(self._errors(weight), self.path, gap)
        return Candidate(label, words, gap, predicted, similarity=similarity)


def spread_out(gaps: Sequence[Gap]) -> list[Gap]:
    """Gaps to run, the most promising first: those that can be predicted by their drift, and, of
    those that cannot, the largest, the smallest and what lies between in turn with them."""
    sure = sorted((g for g in gaps if not g.unsure), key=lambda g: g.drift.value)
    unsure = [g for g in gaps if g.unsure]
    middle = [unsure[len(unsure) // 2]] if unsure else []
    blind = [*middle, *unsure[-1:], *unsure[:1]]
    order = [g for pair in zip(blind, sure, strict=False) for g in pair]
    order += [*blind[len(sure) :], *sure[len(blind) :]]
    kept: list[Gap] = []
    for gap in order:
        if all(_apart(gap.gap, other.gap) for other in kept):
            kept.append(gap)
    return kept


def _apart(a: float, b: float) -> bool:
    return max(a, b) >= APART * min(a, b)


def choices(offered: Array, threshold: float, inside: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Which group (A,) RBTM takes of those that the window holds: the oldest whose score (A, G)
    exceeds the threshold; -1 for none. An undefined score passes nothing."""
    passes = np.asarray((offered > threshold) & inside, bool)
    if passes.size == 0:
        return np.full(len(offered), -1)
    oldest = passes.shape[1] - 1 - np.argmax(passes[:, ::-1], axis=1)
    return np.asarray(np.where(passes.any(axis=1), oldest, -1), np.intp)
