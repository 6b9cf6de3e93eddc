"""The settings that are run: each on the calibration part, the advice and the references on the
reported part, with replicates.

The advice is the best setting on the calibration part, unless it cannot be told apart from one that
is simpler: a reference (``previous``, the default ``keyframe`` and ``rbtm``), one that needs fewer
registrations, or no scores.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rbtm_bench.calibration.shortlist import Candidate
from rbtm_bench.core.columns import MAIN
from rbtm_bench.core.trajectory import Mask
from rbtm_bench.core.types import Array
from rbtm_bench.engine import drive
from rbtm_bench.engine.crew import Supervisor
from rbtm_bench.metrics.relation_errors import FILE, RelationErrors
from rbtm_bench.report import better
from rbtm_bench.report.margin import DEFAULT
from rbtm_bench.report.replicates import trajectory_of, value_of
from rbtm_bench.runs.grid import Point, make_points
from rbtm_bench.runs.stored import Run, is_number, read_run

OWN = ("selector", "out", "overwrite", "pictures", "controls", "replicates", "replicate")
CROP = ("perturb.first_scan", "perturb.end_scan")
DEAR = 1.05
"""A setting that needs so many times the registrations of another is dearer."""
KEPT = 1.1
"""Advice is withdrawn if its error is more than so many times that of a reference on data that did
not choose it, and told apart from it."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A setting and its runs on a part, replicates of every data set; ``wheels`` (R,) by data set:
    the relations that are left out of its error."""

    candidate: Candidate
    runs: list[list[Run]]
    wheels: list[Mask | None]

    @property
    def name(self) -> str:
        """As one would ask for it: with the distance that a default turned out to be."""
        distance = self._first.section("selector").get("distance")
        if self.candidate.reference and is_number(distance):
            return f"{self.candidate.name} ({distance:g} m)"
        return self.candidate.name

    @cached_property
    def values(self) -> Array:
        """The error (R,) of every replicate; infinite for one that failed."""
        return self._errors(0)

    @cached_property
    def of_wheels(self) -> float | None:
        """The median error over the relations that are left out."""
        values = self._errors(1)
        known = values[np.isfinite(values)]
        return float(np.median(known)) if len(known) else None

    @property
    def median(self) -> float:
        return float(np.median(self.values))

    @property
    def failed(self) -> bool:
        return not all(run.done for runs in self.runs for run in runs)

    @property
    def metric(self) -> str:
        """What the error is, with its unit."""
        if self.wheels[0] is not None:
            return "mean error of the relations that are not the wheels' (m)"
        run = next((run for run in self._copies if run.done), self._first)
        names = [f"{c.title} ({c.unit})" for c in MAIN if value_of(run, c.name) is not None]
        return names[0] if names else "error"

    def mean(self, key: str) -> float:
        """The median over runs of a metric."""
        values = [run.metrics.get(key) for runs in self.runs for run in runs]
        known = [float(value) for value in values if value is not None and is_number(value)]
        return float(np.median(known)) if known else float("nan")

    @property
    def cost(self) -> float:
        """Registrations a scan."""
        return self.mean("registrations") / float(self._first.record.get("scans") or np.nan)

    @property
    def trajectories(self) -> list[str]:
        return [trajectory_of(run) for run in self._copies]

    @property
    def _first(self) -> Run:
        return self.runs[0][0]

    @property
    def _copies(self) -> list[Run]:
        return [run for runs in self.runs for run in runs if run.config.get("replicate")]

    def _errors(self, which: int) -> Array:
        pairs = [
            errors_of(run, wheels)[which]
            for runs, wheels in zip(self.runs, self.wheels, strict=True)
            for run in runs
            if run.config.get("replicate")
        ]
        return np.array([np.inf if value is None else value for value in pairs])


def errors_of(run: Run, wheels: Mask | None) -> tuple[float | None, float | None]:
    """A run's error: the mean over relations that are not the wheels' motion, and that over those
    that are; or its main error, and None. None for a run that failed."""
    if not run.done:
        return None, None
    if wheels is not None:
        relations = RelationErrors.read(run.path / FILE)
        groups = relations.used & ~wheels, relations.used & wheels
        of = [float(relations.translation_m[g].mean()) if g.any() else None for g in groups]
        return of[0], of[1]
    values = [value_of(run, column.name) for column in MAIN]
    return next((value for value in values if value is not None), None), None


def compared(ours: Trial, theirs: Trial) -> better.Comparison:
    """Two settings on the same copies of the same data, before Holm."""
    pairs = np.stack([ours.values, theirs.values])
    equal = ours.trajectories == theirs.trajectories
    distinct = min(len(set(t.trajectories)) for t in (ours, theirs))
    p = better.exact_p(*pairs) if np.isfinite(pairs).all() else None
    return better.Comparison(
        pairs, better.REPLICATES, DEFAULT, distinct, equal, (ours.failed, theirs.failed), p
    )


def chosen(trials: Sequence[Trial]) -> Trial:
    """The advice: of the settings that are not told apart from the best one (an exact test over
    replicates, after Holm, and the interval of the ratio), references first, then those that need
    fewer registrations, then those without scores; of references in their order, else the best."""
    best = min(trials, key=lambda t: t.median)
    others = [t for t in trials if t is not best]
    adjusted = better.adjusted([compared(t, best) for t in others])
    alike = [best, *(t for t, c in zip(others, adjusted, strict=True) if not _apart(c))]
    least = min(t.cost for t in alike)

    def order(t: Trial) -> tuple[bool, bool, bool, float]:
        c, dear = t.candidate, t.cost > DEAR * least
        needs_scores = bool(c.similarity) or "selector=rbtm" in c.words
        return not c.reference, dear, needs_scores, trials.index(t) if c.reference else t.median

    return min(alike, key=order)


def _apart(c: better.Comparison) -> bool:
    """Whether the second is truly lower, by however little."""
    if not np.isfinite(c.pairs).all():
        return bool(np.median(c.pairs[0]) == np.inf)
    significant = c.p_holm is not None and c.p_holm < better.SIGNIFICANT
    low = c.ratio.low if c.ratio is not None else None
    return significant and low is not None and low > 1.0


@dataclass(frozen=True, eq=False)
class Verdict:
    """What was run for a backend: ``tried`` on the calibration part, ``shown`` on the reported
    part, the advice first. ``kept``: it stands; ``instead``: else the reference to take."""

    tried: list[Trial]
    shown: list[Trial]
    comparisons: list[better.Comparison] = field(default_factory=list)

    @property
    def advice(self) -> Trial:
        return self.shown[0]

    @property
    def references(self) -> list[Trial]:
        return [t for t in self.shown if t.candidate.reference]

    @property
    def instead(self) -> Trial:
        return min(self.references, key=lambda t: t.median)

    @property
    def kept(self) -> bool:
        beside = dict(zip(self.shown[1:], self.comparisons, strict=True))
        worse = self.advice.median > KEPT * self.instead.median
        return not (worse and _apart(beside[self.instead]))


class Place(NamedTuple):
    """A data set: the words of a run on it, the scans of its two parts (first, and the one behind
    the last), and the relations (R,) that are left out of errors."""

    words: Sequence[str]
    calibration: tuple[int, int]
    reported: tuple[int, int]
    of_wheels: Mask | None


@dataclass(frozen=True)
class Trials:
    """Runs settings below ``out`` with a crew."""

    places: Sequence[Place]
    replicates: int
    out: Path
    extra_dirs: tuple[Path, ...]
    crew: Sequence[Supervisor]
    advance: Callable[[str, int, int], None]

    def verdict(
        self, backend: str, candidates: Sequence[Candidate], similarities: Mapping[str, Any]
    ) -> Verdict:
        """The candidates on the calibration part; the advice and the references on the other."""
        tried = self._run(0, backend, candidates, similarities)
        advice = chosen(tried)
        references = [t.candidate for t in tried if t.candidate.reference]
        others = [c for c in references if c is not advice.candidate]
        shown = self._run(1, backend, [advice.candidate, *others], similarities)
        comparisons = better.adjusted([compared(shown[0], t) for t in shown[1:]])
        return Verdict(tried, shown, comparisons)

    def _run(
        self,
        part: int,
        backend: str,
        candidates: Sequence[Candidate],
        similarities: Mapping[str, Any],
    ) -> list[Trial]:
        folder = self.out / "runs" / ("calibration", "reported")[part]
        by_candidate = [
            [self._points(place, part, backend, c, similarities, f"{n}") for n, place in
             enumerate(self.places)]
            for c in candidates
        ]  # fmt: skip
        flat = [point for places in by_candidate for points in places for point in points]
        flat.sort(key=lambda point: point.settings.config["replicate"])  # a copy at a time
        count = iter(range(1, len(flat) + 1))
        word = ("runs on the calibration part", "runs on the reported part")[part]
        drive.run_points(
            flat, folder, len(self.crew), lambda *_: self.advance(word, next(count), len(flat)),
            crew=self.crew,
        )  # fmt: skip
        return [
            Trial(
                candidate,
                [[read_run(folder / point.name) for point in points] for points in places],
                [place.of_wheels for place in self.places],
            )
            for candidate, places in zip(candidates, by_candidate, strict=True)
        ]

    def _points(
        self,
        place: Place,
        part: int,
        backend: str,
        candidate: Candidate,
        similarities: Mapping[str, Any],
        number: str,
    ) -> list[Point]:
        first, end = place.reported if part else place.calibration
        crop = [f"{key}={value}" for key, value in zip(CROP, (first, end), strict=True)]
        by = similarities[candidate.similarity] if candidate.similarity else []
        copies = ",".join(map(str, range(1, self.replicates + 1)))
        how = ["pictures=false", "controls=none", f"replicate={copies}"]
        asked = [*_without(place.words, by), *by, *candidate.words, *crop, *how]
        points, _ = make_points(asked, self.extra_dirs)
        stem = "-".join([number, backend, candidate.name])
        slug = re.sub(r"[^\w.=+-]+", "_", stem)[:90]
        return [Point(f"{slug}-{p.settings.config['replicate']}", p.settings) for p in points]


def _without(words: Sequence[str], by: Sequence[str]) -> list[str]:
    """The words of a run without what a trial says itself."""
    groups = {*OWN, *(["similarity"] if by else [])}
    return [
        word
        for word in words
        if (key := word.lstrip("+").partition("=")[0]) not in CROP
        and key not in groups
        and not (key.startswith("selector.") or (by and key.startswith("similarity.")))
    ]
