"""What follows a refusal, and scans that hardly move: through the loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from loop_helpers import Perfect, drive, method, true_pose

from rbtm_bench.backends.base import Alignment, Prepared
from rbtm_bench.check.base import Check
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import inverse, se2
from rbtm_bench.core.types import Array, RegistrationResult, Scan, StepTable
from rbtm_bench.guess.constant_velocity import ConstantVelocity
from rbtm_bench.metrics.summary import summarise_steps, why_unregistered
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.odometry.method import MotionFilter
from rbtm_bench.recovery.base import Recovery, Restart
from rbtm_bench.recovery.restarts import Restarts
from rbtm_bench.runs.settings import compose_settings


class Local(Perfect):
    """Finds the truth from starts less than 0.05 m off, else stays where it started."""

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        exact = super().align(source, target, T_target_source)
        off = np.linalg.norm((exact.T_target_source - T_target_source)[:3, 3])
        return exact if off < 0.05 else replace(exact, T_target_source=T_target_source)


class Named(Recovery):
    def __init__(self, *starts: Restart, fails: bool = False) -> None:
        self.starts, self.fails = starts, fails

    def restarts(
        self, source: Prepared, target: Prepared, T_guess: Array, T_rest: Array
    ) -> Sequence[Restart]:
        if self.fails:
            raise BackendError("nothing to search")
        return self.starts


class Exact(Check):
    """Believes nothing but the truth of scan 1; keeps what it accepted."""

    def __init__(self) -> None:
        self.accepted: list[RegistrationResult] = []

    def reject(self, result: RegistrationResult, T_guess: Array) -> str | None:
        off = np.abs(result.T_target_source - inverse(true_pose(0)) @ true_pose(1)).max()
        return None if off < 1e-6 else f"off by {off:.2f}"

    def accept(self, result: RegistrationResult) -> None:
        self.accepted.append(result)


def of_first_pair(recovery: Recovery, wrong: float = 0.2):
    """The row of scan 1, whose odometry is off by ``wrong`` m, the backend, the check."""
    scans = drive(2)
    scans[1] = replace(scans[1], odometry=true_pose(1) @ se2(wrong, 0, 0))
    backend, check = Local(), Exact()
    way = replace(method(backend, check=check), recovery=recovery)
    steps = list(odometry(scans, way))
    return steps[1].record, backend, check


def test_a_refusal_is_followed_by_other_starts_and_the_best_is_believed() -> None:
    truth = inverse(true_pose(0)) @ true_pose(1)
    bad, good = Restart("bad", truth @ se2(0, 0.7, 0)), Restart("good", truth @ se2(0.01, 0, 0))
    row, backend, check = of_first_pair(Named(bad, good))
    assert (row.status, row.recovered, row.registrations, row.rejected) == (
        "registered",
        "good",
        3,
        0,
    )
    assert len(backend.calls) == 3 and len(check.accepted) == 1
    row, backend, _ = of_first_pair(Named(bad, good), wrong=0.0)  # nothing was refused
    assert (row.recovered, row.registrations) == ("", 1)


@pytest.mark.parametrize(
    "recovery", [Named(), Named(fails=True), Restarts(rest=False, translation=0.0)]
)
def test_where_no_start_is_believed_the_first_reason_stands(recovery: Recovery) -> None:
    row, _, check = of_first_pair(recovery)
    assert (row.status, row.recovered, row.rejected) == ("predicted", "", 1)
    assert row.reason.startswith("off by 0.2") and not check.accepted


def test_rest_mends_a_guess_that_ran_ahead() -> None:
    scans = [replace(scan, odometry=None) for scan in drive(4)]
    still = Scan(4, 0.4, scans[3].points)  # the sensor stops at once

    class Standing(Local):
        def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
            if source.native == 4:
                off = np.linalg.norm(T_target_source[:3, 3])
                return Alignment(np.eye(4) if off < 0.05 else T_target_source, True)
            return Perfect.align(self, source, target, T_target_source)

    class Still(Exact):
        def reject(self, result: RegistrationResult, T_guess: Array) -> str | None:
            return None if result.fitness > 0.9 else "poor"

    way = method(Standing(), guess=ConstantVelocity(), check=Still())
    way = replace(way, recovery=Restarts(half=False, translation=0.0))
    last = list(odometry([*scans, still], way))[-1]
    assert last.record.recovered == "rest" and last.record.model == 3


class AtGuess(Perfect):
    """Stays where it starts."""

    def align(self, source: Prepared, target: Prepared, T_target_source: Array) -> Alignment:
        return Alignment(T_target_source, True)


def test_scans_that_hardly_move_are_not_registered() -> None:
    scans = drive(3)
    creeping = [replace(scans[2], index=3 + i, odometry=scans[2].odometry @ se2(0.008 * i, 0, 0))
                for i in range(4)]  # fmt: skip
    way = replace(method(AtGuess()), motion_filter=MotionFilter(0.02, 0.5))
    steps = list(odometry([*scans, *creeping], way))
    status = [step.record.status for step in steps]
    # 0, 0.008 and 0.016 m after the last that moved; 0.024 m is registered
    assert status == ["first", "registered", "registered", "still", "still", "still", "registered"]
    assert steps[4].edges[0].kind == "predicted" and steps[6].record.model == 2
    assert steps[6].edges[0].T_model_scan[0, 3] == pytest.approx(0.024)
    values = summarise_steps(StepTable([step.record for step in steps]))
    assert (values["coverage"], values["still"], values["longest_skip"]) == (1.0, 3, 0)
    assert why_unregistered(StepTable([step.record for step in steps])) == ""


def test_a_motion_filter_wants_a_guess_that_measures() -> None:
    from rbtm_bench.core.errors import ConfigError
    from rbtm_bench.runs.assembly import build, check_fit

    words = ["motion_filter.distance=0.02", "motion_filter.angle_deg=0.5"]
    settings = compose_settings([*words, "guess=constant_velocity"])
    with pytest.raises(ConfigError, match="guess=constant_velocity does not measure"):
        check_fit(settings, build(settings.config["dataset"]))
