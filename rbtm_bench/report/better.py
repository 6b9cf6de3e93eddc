"""When one method is called better than another: the rule, and the words.

Replicates of a log are the unit on that log. "Better" takes all of

(a) an exact paired test over replicates, adjusted for all comparisons of the table (Holm), p < .05;
(b) the bootstrap interval of the ratio of medians beyond the placebo margin: the ratio that
    neighbouring settings, which nobody would tell apart, reach on such a log;
(c) at least 8 distinct trajectories on either side, and no failed run on the better one.

Over data sets (seeds of a simulation, logs) the unit is the data set, with six or more; the margin
is a log's, so there the interval need only exclude equality. One run says no more than "lower on
this run".
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from rbtm_bench.core.types import Array
from rbtm_bench.report import intervals
from rbtm_bench.report.best_settings import NO_METHODS
from rbtm_bench.report.frame import MethodRuns
from rbtm_bench.report.margin import DEFAULT, Margin, margin_of
from rbtm_bench.report.render import three_digits
from rbtm_bench.report.replicates import Draw, draw_of, trajectory_of, value_of
from rbtm_bench.runs.stored import Run

SIGNIFICANT = 0.05
DISTINCT = 8
"""Distinct trajectories that either side takes: the exact test of 8 pairs reaches p = .008."""
EXACT = 12
"""Pairs up to which every way to flip the signs is gone through."""
REPLICATES, DATA_SETS, RUNS = "replicates", "data sets", "runs"


def exact_p(ours: ArrayLike, theirs: ArrayLike) -> float | None:
    """Two-sided p of paired values (n,) under "which is which is a coin's toss".

    Sign flips of the log ratios (of the differences, if a value is not positive), their mean as
    the statistic: all 2^n of up to 12 pairs, of more the signed-rank test. None without any
    difference, or for fewer than two pairs.
    """
    from scipy.stats import permutation_test, wilcoxon

    a, b = np.asarray(ours, np.float64), np.asarray(theirs, np.float64)
    positive = bool((a > 0).all() and (b > 0).all())
    off = np.log(a) - np.log(b) if positive else a - b
    off[np.isclose(a, b, rtol=1e-9, atol=1e-12)] = 0.0
    if len(off) < 2 or not off.any():
        return None
    if len(off) > EXACT:
        return float(wilcoxon(off[off != 0], method="auto").pvalue)
    flips = permutation_test(
        (off,), np.mean, permutation_type="samples", n_resamples=np.inf, vectorized=True
    )
    return float(flips.pvalue)


def needed(tests: int) -> int:
    """Pairs with which one of so many comparisons can reach p < .05 after Holm at all."""
    return math.floor(math.log2(2 * max(tests, 1) / SIGNIFICANT)) + 1


def too_few(comparisons: Sequence[Comparison]) -> str:
    """That no difference can show among so many comparisons, however large; "" where one can."""
    tested = [one for one in comparisons if one.unit != RUNS]
    most = max((one.n for one in tested), default=0)
    at_least = max((needed(one.tests) for one in tested), default=0)
    if not most or most >= at_least:
        return ""
    tests = max(one.tests for one in tested)
    unit = tested[0].unit
    return f"{most} {unit} cannot part any of {tests} comparisons, {at_least} could"


@dataclass(frozen=True, eq=False)
class Comparison:
    """A method beside another by one error: ``pairs`` (2, n) are the values of ours and of theirs,
    paired by ``unit``, ``distinct`` the trajectories of the side with fewer; ``failed``: whether a
    run of ours, of theirs failed. ``p_holm`` is p among ``tests``."""

    pairs: Array
    unit: str
    margin: Margin
    distinct: int = 0
    equal: bool = False
    failed: tuple[bool, bool] = (False, False)
    p: float | None = None
    p_holm: float | None = None
    tests: int = 1

    @property
    def n(self) -> int:
        return self.pairs.shape[1]

    @cached_property
    def ours(self) -> float:
        return float(np.median(self.pairs[0]))

    @cached_property
    def theirs(self) -> float:
        return float(np.median(self.pairs[1]))

    @cached_property
    def ratio(self) -> intervals.Interval | None:
        """Of ours / theirs; None where a value is not positive, and of runs that are no pairs."""
        return None if self.unit == RUNS else intervals.ratio_interval(*self.pairs)

    @property
    def less(self) -> bool:
        return self.ours < self.theirs

    @property
    def shortfalls(self) -> list[str]:
        """Why neither is called better; empty if one is."""
        if self.unit == RUNS or self.ratio is None or self.ratio.low is None:
            return [f"{self.n} {'run' if self.n == 1 else 'runs'}"]
        reasons = []
        low, high = self.ratio.low, self.ratio.high or math.inf
        factor = self.margin.factor if self.unit == REPLICATES else 1.0
        if self.unit == REPLICATES and self.distinct < DISTINCT:
            reasons.append(f"{self.distinct} distinct trajectories of {DISTINCT}")
        elif self.p_holm is None or self.p_holm >= SIGNIFICANT:
            reasons.append(self._no_test())
        if not (high < 1 / factor or low > factor):
            times = sorted([low, high] if not self.less else [1 / high, 1 / low])
            what = f"{times[0]:.3g} to {times[1]:.3g} times"
            within = f"not beyond {factor:.3g}, what placebos reach" if factor > 1 else "may be 1"
            reasons.append(f"{what}, {within}")
        if self.failed[0 if self.less else 1]:
            reasons.append("a run of it failed")
        return reasons

    def _no_test(self) -> str:
        of = f" of {self.tests}" if self.tests > 1 else ""
        at_least = needed(self.tests)
        if self.n < at_least:
            return f"{self.n} pairs cannot hold{of}: {at_least} {self.unit} needed"
        return "p undefined" if self.p_holm is None else f"p {self.p_holm:.2g}{of}"

    @property
    def holds(self) -> str:
        """ "better", "worse", or "" where that cannot be said."""
        if self.equal or self.p_holm is None or self.p_holm >= SIGNIFICANT or self.shortfalls:
            return ""
        return "better" if self.less else "worse"

    def words(self, name: str) -> str:
        """What may be said of ``name``, ours."""
        if self.equal:
            return f"{name} is equal, trajectory by trajectory"
        if self.ours == self.theirs:
            return f"{name} is equal"
        small, large = sorted((self.ours, self.theirs))
        times = f"{large / small:.3g} times " if small > 0 else ""
        if self.holds:
            return f"{name} is {times}{self.holds} {self._basis()}"
        close = small > 0 and large / small < 1.05
        word = "within 5%" if close else f"{times}{'lower' if self.less else 'higher'}"
        if self.unit == RUNS:
            where = "this run" if self.n == 1 else f"these {self.n} runs"
            return f"{name} is {word} on {where}"
        return f"{name} is {word}, not called {self._not()} ({'; '.join(self.shortfalls)})"

    def _not(self) -> str:
        return "better" if self.less else "worse"

    def _basis(self) -> str:
        assert self.ratio is not None and self.ratio.low is not None and self.ratio.high is not None
        ends = [self.ratio.low, self.ratio.high]
        low, high = sorted(1 / end for end in ends) if self.less else ends
        about = f"[{three_digits(low)}, {three_digits(high)}], p {self.p_holm:.2g}"
        if self.unit == REPLICATES:
            return f"on this log, under these perturbations ({about}, {self.n} replicates)"
        return f"over {self.n} data sets ({about})"


def compare(ours: MethodRuns, theirs: MethodRuns, key: str, margin: Margin) -> Comparison | None:
    """Two methods by an error, before Holm; None if they share no data that both have it on."""
    a, b = _by_draw(ours.runs), _by_draw(theirs.runs)
    draws = [draw for draw in a if draw in b and _known(a[draw], key) and _known(b[draw], key)]
    copied = {draw[0] for draw in draws if draw[1]}
    draws = [draw for draw in draws if draw[1] or draw[0] not in copied]
    pairs: dict[tuple[str, str], Draw] = {}
    for draw in draws:  # equal trajectories on both sides count once
        pairs.setdefault((_trajectories(a[draw]), _trajectories(b[draw])), draw)
    if not pairs:
        return None
    x = np.array([_value(a[draw], key) for draw in pairs.values()])
    y = np.array([_value(b[draw], key) for draw in pairs.values()])
    data = [draw[0] for draw in pairs.values()]
    names = list(dict.fromkeys(data))
    unit = REPLICATES if len(names) == 1 and copied else RUNS
    if len(names) >= intervals.INDEPENDENT:
        unit = DATA_SETS
        groups = [np.array([name == one for one in data]) for name in names]
        x, y = (np.array([np.median(v[g]) for g in groups]) for v in (x, y))
    distinct = min(len({pair[side] for pair in pairs}) for side in (0, 1))
    equal = all(pair[0] == pair[1] for pair in pairs)
    failed = (ours.row["status"] != "done", theirs.row["status"] != "done")
    p = None if unit == RUNS else exact_p(x, y)
    return Comparison(np.stack([x, y]), unit, margin, distinct, equal, failed, p)


def beside_best(
    best: MethodRuns, group: Sequence[MethodRuns], key: str
) -> list[tuple[MethodRuns, Comparison]]:
    """The best method of a data set beside every other of the group that has a number, but for
    those that win nothing, adjusted for all of these."""
    margin = margin_of(group, key)
    others = [m for m in group if m is not best and m.row["selector"] not in NO_METHODS]
    compared = [(m, compare(best, m, key, margin)) for m in others]
    known = [(m, one) for m, one in compared if one is not None]
    pairs = zip(known, adjusted([one for _, one in known]), strict=True)
    return [(method, one) for (method, _), one in pairs]


def of_runs(ours: float, theirs: float, runs: int = 1) -> Comparison:
    """Two medians over so many runs, of which nothing more is known."""
    return Comparison(np.repeat([[ours], [theirs]], runs, axis=1), RUNS, DEFAULT)


def adjusted(comparisons: Sequence[Comparison]) -> list[Comparison]:
    """The same, each knowing how many there are."""
    p = intervals.holm([one.p for one in comparisons])
    tests = sum(one.p is not None for one in comparisons)
    return [
        replace(one, p_holm=q, tests=max(tests, 1)) for one, q in zip(comparisons, p, strict=True)
    ]


def _by_draw(runs: Sequence[Run]) -> dict[Draw, list[Run]]:
    together: dict[Draw, list[Run]] = {}
    for run in runs:
        if run.done:
            together.setdefault(draw_of(run), []).append(run)
    return together


def _known(runs: Sequence[Run], key: str) -> bool:
    return all(value_of(run, key) is not None for run in runs)


def _value(runs: Sequence[Run], key: str) -> float:
    return float(np.median([value for run in runs if (value := value_of(run, key)) is not None]))


def _trajectories(runs: Sequence[Run]) -> str:
    return " ".join(sorted(trajectory_of(run) for run in runs))
