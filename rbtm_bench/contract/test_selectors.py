"""Every selector orders members of its window, always has an answer, and remembers little."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from rbtm_bench.contract.members import Catalogue, Member
from rbtm_bench.contract.scene import TinyClouds
from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.geometry import inverse, se2
from rbtm_bench.core.types import Array, Node, RegistrationResult, Scan
from rbtm_bench.runs.assembly import check_fit
from rbtm_bench.runs.settings import compose_settings
from rbtm_bench.selection.base import Candidate, Selection, Selector, Trial

GROUP = "selector"
SCANS = 30
Scores = Callable[[int, int], Array]
"""Scan number and window length -> scores (W,)."""


def random_scores(scan: int, count: int) -> Array:
    """Scores in [-1, 1], every fifth undefined."""
    scores = np.random.default_rng(scan).uniform(-1, 1, count)
    scores[::5] = np.nan
    return scores


KINDS: dict[str, Scores] = {
    "random": random_scores,
    "undefined": lambda scan, count: np.full(count, np.nan),
    "alike": lambda scan, count: np.ones(count),
    "opposite": lambda scan, count: -np.ones(count),
}


@pytest.fixture
def selector(catalogue: Catalogue, member: Member) -> Selector:
    """The selector under test, new for every test: some draw random numbers."""
    selector: Selector = catalogue.build(member)
    return selector


def scan_at(number: int, truth: bool = True) -> Scan:
    """A scan 0.1 m on from the one before."""
    points = np.array([[2.0, 0, 0], [0, 3.0, 0], [-1.0, -1.0, 0]])
    pose = se2(0.1 * number, 0, 0)
    return Scan(number, 0.1 * number, points, True, ground_truth=pose if truth else None)


def node_at(selector: Selector, number: int) -> Node:
    """The scan as a member of the window, a chain of hops of one a scan."""
    descriptor = np.full(3, float(number)) if selector.needs_scores else None
    covariance = None if selector.covariance_from is None else 1e-4 * number * np.eye(6)
    pose = se2(0.1 * number, 0, 0)
    return Node(number, 0.1 * number, pose, None, None, descriptor, number, covariance)


def run(selector: Selector, scores: Scores, skip: frozenset[int] = frozenset()) -> list[Selection]:
    """Thirty scans 0.1 m apart through a window, as the loop does it, without a backend.

    Scans in ``skip`` never become members. Every selection is checked.
    """
    window = selector.window()
    selections = []
    for scan in range(SCANS):
        if selector.needs_truth or selector.needs_scans:
            selector.see(scan_at(scan, truth=selector.needs_truth))
        if len(window):
            given = scores(scan, len(window))
            models, before, members = window.scans.copy(), given.copy(), list(window.nodes)
            selection = selector.choose(scan, window, given)
            assert np.array_equal(window.scans, models), "choose() modified the window's scans"
            assert window.nodes == members, "choose() modified the window"
            assert np.array_equal(given, before, equal_nan=True), "choose() modified the scores"
            check_selection(selection, models, before)
            selections.append(selection)
        if scan not in skip:
            window.push(node_at(selector, scan))
        assert len(window) <= selector.capacity, (
            f"the window holds {len(window)} scans, more than capacity = {selector.capacity}"
        )
    return selections


def check_selection(selection: Selection, models: NDArray[np.int64], scores: Array) -> None:
    """What every selection must look like."""
    chosen = [candidate.model for candidate in selection.candidates]
    strangers = set(chosen) - set(models.tolist())
    assert not strangers, f"candidates {sorted(strangers)} are not in the window {models.tolist()}"
    assert len(chosen) == len(set(chosen)), f"a candidate twice in {chosen}: each is tried once"
    for candidate in selection.candidates:
        score = scores[models.tolist().index(candidate.model)]
        same = np.array_equal(candidate.score, score, equal_nan=True)
        assert same, f"candidate {candidate.model} has score {candidate.score}, was given {score}"
        assert candidate.reason.strip(), f"candidate {candidate.model} has no reason"
    flags = [candidate.is_fallback for candidate in selection.candidates]
    assert not any(flags[:-1]), "the fallback must come last, and once"
    assert 0 <= selection.undefined <= len(models), "undefined: expected a count of NaN scores"


@pytest.mark.parametrize("kind", list(KINDS))
def test_every_scan_gets_a_candidate(selector: Selector, kind: str) -> None:
    selections = run(selector, KINDS[kind])
    assert len(selections) == SCANS - 1, "the window stayed empty after the first scan"
    if selector.fallback != "skip":
        empty = sum(not s.candidates for s in selections)
        assert not empty, f"{empty} scans have no candidate although fallback is not 'skip'"


def test_missing_scans_do_no_harm(selector: Selector) -> None:
    """Skipped and unusable scans never become members."""
    run(selector, random_scores, skip=frozenset({3, 4, 11, 20, 21, 22, 23}))


def test_without_scores_they_do_not_matter(catalogue: Catalogue, member: Member) -> None:
    """The loop gives NaN to a selector that says it needs no scores."""
    first, second = (catalogue.build(member) for _ in range(2))
    if first.needs_scores:
        pytest.skip(f"{member} needs scores")
    models = [
        [[c.model for c in s.candidates] for s in run(selector, KINDS[kind])]
        for selector, kind in ((first, "undefined"), (second, "random"))
    ]
    assert models[0] == models[1], "the choice depends on scores: set needs_scores = True"


def test_two_runs_choose_alike(catalogue: Catalogue, member: Member) -> None:
    first, second = (run(catalogue.build(member), random_scores) for _ in range(2))
    assert repr(first) == repr(second), "two runs choose otherwise: take a seed as a parameter"


def test_undefined_scores_are_counted(selector: Selector) -> None:
    if not selector.needs_scores:
        pytest.skip("needs no scores")
    for selection, count in zip(
        run(selector, KINDS["undefined"]), run_lengths(selector), strict=True
    ):
        assert selection.undefined == count, "undefined: expected the number of NaN scores"


def run_lengths(selector: Selector) -> list[int]:
    """The window's length at each scan after the first."""
    lengths: list[int] = []

    def scores(scan: int, count: int) -> Array:
        lengths.append(count)
        return np.full(count, np.nan)

    run(selector, scores)
    return lengths


def test_fallback_skip_may_leave_a_scan_alone(catalogue: Catalogue, member: Member) -> None:
    if "fallback" not in catalogue.node(member):
        pytest.skip(f"{member} has no setting fallback")
    selector = catalogue.build(member, "selector.fallback=skip")
    for selection in run(selector, KINDS["undefined"]):
        assert not any(c.is_fallback for c in selection.candidates), (
            "a fallback candidate in spite of fallback=skip"
        )


def trials(selector: Selector, scan: int, models: list[int]) -> list[Trial]:
    """Accepted registrations to models, each off by as many mm as the scans lie apart."""
    trials = []
    for model in models:
        off = se2(0.001 * (scan - model), 0, 0)
        T = inverse(se2(0.1 * model, 0, 0)) @ se2(0.1 * scan, 0, 0) @ off
        result = RegistrationResult(T, True, 0.9, 0.01, 3)
        candidate = Candidate(model, 0.9, "a candidate")
        trials.append(Trial(candidate, node_at(selector, model), result))
    return trials


def test_it_picks_one_of_what_was_accepted(selector: Selector) -> None:
    """One, or, for a selector that tries all, several; some were rejected."""
    selector.window()
    if selector.needs_truth:
        for number in range(10):
            selector.see(scan_at(number))
    for models in ([4], [2, 4, 7], [8, 3]) if selector.tries_all else ([4], [8]):
        given = trials(selector, 9, models)
        which, why = selector.pick(scan_at(9, truth=False), given)
        assert 0 <= which < len(models), f"picked number {which} of {len(models)}"
        assert why.strip(), "picked without a reason"
        again = selector.pick(scan_at(9, truth=False), given)
        assert again == (which, why), "the same trials, another pick"


def test_who_sees_the_truth_says_so(
    selector: Selector, catalogue: Catalogue, member: Member
) -> None:
    """It is refused where there is none, and the reason of every result tells."""
    if not selector.needs_truth:
        pytest.skip(f"{member} sees no ground truth")
    settings = compose_settings([])
    config = {**settings.config, "selector": catalogue.node(member)}
    settings = replace(settings, config=config)
    with pytest.raises(ConfigError, match="ground truth"):
        check_fit(settings, TinyClouds())
    selector.window()
    with pytest.raises(DataError, match="scan 3"):
        selector.see(scan_at(3, truth=False))
    for number in range(10):
        selector.see(scan_at(number))
    _, why = selector.pick(scan_at(9, truth=False), trials(selector, 9, [8, 4]))
    assert "truth" in why, f"the reason of every result must say that truth was seen, not {why!r}"
