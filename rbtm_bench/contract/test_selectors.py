"""Every selector orders members of its window, always has an answer, and remembers little."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from rbtm_bench.contract.members import Catalogue, Member
from rbtm_bench.geometry import se2
from rbtm_bench.selection.base import Selection, Selector
from rbtm_bench.types import Array, Node

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


def run(selector: Selector, scores: Scores, skip: frozenset[int] = frozenset()) -> list[Selection]:
    """Thirty scans 0.1 m apart through a window, as the loop does it, without a backend.

    Scans in ``skip`` never become members. Every selection is checked.
    """
    window = selector.window()
    selections = []
    for scan in range(SCANS):
        if len(window):
            given = scores(scan, len(window))
            models, before = window.scans.copy(), given.copy()
            selection = selector.select(scan, window.scans, given)
            assert np.array_equal(window.scans, models), "select() modified the window's scans"
            assert np.array_equal(given, before, equal_nan=True), "select() modified the scores"
            check_selection(selection, models, before)
            selections.append(selection)
        if scan not in skip:
            descriptor = np.full(3, float(scan)) if selector.needs_scores else None
            window.push(Node(scan, 0.1 * scan, se2(0.1 * scan, 0, 0), descriptor=descriptor))
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
