"""Every check accepts a perfect registration and gives its reasons for refusing another."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rbtm_bench.check.base import Check
from rbtm_bench.contract.members import Catalogue, Member
from rbtm_bench.core.geometry import se2
from rbtm_bench.core.types import RegistrationResult

GROUP = "check"
GUESS = se2(0.1, 0.02, 0.05)
GOOD = RegistrationResult(GUESS.copy(), True, 1.0, 0.005, 500, iterations=5, seconds=0.01)
RESULTS = {
    "perfect": GOOD,
    "silent": replace(GOOD, converged=None, iterations=None),
    "failed": replace(GOOD, converged=False, fitness=0.0, inlier_rmse=float("nan"), inliers=0),
    "far": replace(GOOD, T_target_source=se2(50.0, 3.0, 3.0)),
    "thin": replace(GOOD, fitness=0.01, inliers=3),
}


@pytest.fixture(scope="module")
def check(catalogue: Catalogue, member: Member) -> Check:
    """The check under test."""
    check: Check = catalogue.build(member)
    return check


@pytest.mark.parametrize("kind", list(RESULTS))
def test_a_refusal_has_a_reason(check: Check, kind: str) -> None:
    result = RESULTS[kind]
    before = result.T_target_source.tobytes(), GUESS.tobytes()
    verdict = check.reject(result, GUESS)
    assert verdict is None or (isinstance(verdict, str) and verdict.strip()), (
        f"reject() gave {verdict!r}: expected None to accept, or why not in words"
    )
    after = result.T_target_source.tobytes(), GUESS.tobytes()
    assert after == before, "reject() modified the result or the guess"


def test_a_perfect_registration_passes(check: Check) -> None:
    verdict = check.reject(GOOD, GUESS)
    assert verdict is None, f"converged, fitness 1, at its guess, and still rejected: {verdict}"


def test_the_verdict_repeats(check: Check) -> None:
    for kind, result in RESULTS.items():
        verdicts = {check.reject(result, GUESS) for _ in range(3)}
        assert len(verdicts) == 1, f"{kind}: the verdict changes from call to call: {verdicts}"
