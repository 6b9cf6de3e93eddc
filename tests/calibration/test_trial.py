"""What is chosen out of runs, what is withdrawn, and which relations count."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rbtm_bench.calibration.shortlist import REFERENCES, Candidate, Gap, choices, spread_out
from rbtm_bench.calibration.trial import Trial, Verdict, chosen, compared, errors_of
from rbtm_bench.metrics.relation_errors import FILE, RelationErrors
from rbtm_bench.report import better
from rbtm_bench.report.intervals import Interval
from rbtm_bench.runs.stored import Run

KEYFRAME, PREVIOUS, RBTM = REFERENCES
OTHER = Candidate("keyframe 0.9 m", ("selector=keyframe", "selector.distance=0.9"))
SCORED = Candidate("rbtm 0.5", ("selector=rbtm",), similarity="overlap")
UP = np.linspace(0.9, 1.1, 10)


def trial(candidate: Candidate, values: Any, registrations: int = 99) -> Trial:
    """Ten replicates with these errors; None for a run that failed."""
    runs = [
        Run(
            Path(f"{candidate.name}-{number}"),
            {"status": "failed" if value is None else "done", "scans": 100},
            {"replicate": number, "selector": {}},
            {} if value is None else {"ape_rmse_m": value, "registrations": registrations},
        )
        for number, value in enumerate([1.0, *values])
    ]
    return Trial(candidate, [runs], [None])


def test_the_best_that_is_told_apart() -> None:
    trials = [trial(KEYFRAME, 2 * UP), trial(PREVIOUS, 5 * UP), trial(OTHER, 1 * UP)]
    assert chosen(trials).candidate is OTHER
    assert trials[0].values.tolist() == pytest.approx(list(2 * UP))  # replicate 0 is no replicate


def test_a_reference_that_is_not_told_apart_is_preferred() -> None:
    close = UP[::-1] * 1.02
    trials = [trial(KEYFRAME, close), trial(PREVIOUS, 0.99 * UP[[1, 0, 3, 2, *range(4, 10)]])]
    assert chosen([*trials, trial(OTHER, UP)]).candidate is KEYFRAME
    assert chosen([trial(KEYFRAME, 3 * UP), trial(RBTM, close), trial(OTHER, UP)]).candidate is RBTM


def test_costs_are_weighed() -> None:
    close = UP[::-1] * 1.02
    assert chosen([trial(KEYFRAME, close, 300), trial(PREVIOUS, UP)]).candidate is PREVIOUS
    assert (
        chosen([trial(KEYFRAME, 9 * UP), trial(SCORED, UP), trial(OTHER, close)]).candidate is OTHER
    )


def test_a_setting_that_fails_is_not_chosen() -> None:
    failing = trial(OTHER, [*UP[:3], *[None] * 7])
    assert failing.failed and failing.median == np.inf
    assert chosen([trial(KEYFRAME, UP), failing]).candidate is KEYFRAME


def test_advice_that_loses_is_withdrawn_in_favour_of_a_reference() -> None:
    def verdict(of_keyframe: Any) -> Verdict:
        shown = [trial(OTHER, UP), trial(KEYFRAME, of_keyframe), trial(PREVIOUS, 4 * UP)]
        return Verdict([], shown, better.adjusted([compared(shown[0], t) for t in shown[1:]]))

    assert verdict(2 * UP).kept and verdict(UP[::-1] * 0.99).kept
    lost = verdict(0.8 * UP)
    assert not lost.kept and lost.instead.candidate is KEYFRAME
    assert verdict(0.95 * UP).kept  # truly less, but within a tenth


def test_relations_of_the_wheels_are_apart(tmp_path: Path) -> None:
    numbers = np.arange(4.0)
    errors = RelationErrors(
        numbers, numbers + 1, np.ones(4, bool), np.array([0.1, 0.001, 0.3, np.nan]), numbers
    )
    errors.write(tmp_path / FILE)
    run: Any = SimpleNamespace(done=True, path=tmp_path)
    assert errors_of(run, np.array([False, True, False, False])) == pytest.approx((0.2, 0.001))
    assert errors_of(run, np.zeros(4, bool)) == (pytest.approx(0.401 / 3), None)
    assert errors_of(SimpleNamespace(done=False), None) == (None, None)  # type: ignore[arg-type]


def gap(number: int, value: float, unsure: str = "") -> Gap:
    return Gap(number, 99, None, 1.0, Interval(value, None, None, 9), unsure)  # type: ignore[arg-type]


def test_gaps_to_run_are_the_least_and_apart() -> None:
    gaps = [gap(1, 0.5), gap(2, 0.1), gap(8, 0.02), gap(9, 0.01), gap(16, 0.03)]
    assert [g.gap for g in spread_out(gaps)] == [9, 16, 2, 1]


def test_of_gaps_that_cannot_be_predicted_some_are_run() -> None:
    gaps = [gap(1, 0.5), gap(2, 0.4), *(gap(n, 0.01, "noise") for n in (4, 8, 16))]
    assert [g.gap for g in spread_out(gaps)] == [8, 2, 16, 1, 4]


def test_the_oldest_that_passes() -> None:
    offered = np.array([[0.9, 0.8, 0.1], [0.9, 0.2, 0.8], [0.1, 0.1, 0.1], [np.nan, 0.9, np.nan]])
    every = np.ones(3, bool)
    assert choices(offered, 0.5, every).tolist() == [1, 2, -1, 1]
    assert choices(offered, 0.5, np.array([True, True, False])).tolist() == [1, 0, -1, 1]
    assert choices(offered, 0.8, every).tolist() == [0, 0, -1, 1]  # exceeds: 0.8 does not
    assert choices(np.zeros((2, 0)), 0.5, np.zeros(0, bool)).tolist() == [-1, -1]
