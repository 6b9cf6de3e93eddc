"""Which stage a second is counted in, by a clock that only the fakes move; when a restart comes."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest
from loop_helpers import NAN, Pair, Perfect, Script, drive, method

from rbtm_bench.backends.base import Prepared
from rbtm_bench.check.base import Check
from rbtm_bench.core.types import Array, RegistrationResult, Scan, Step
from rbtm_bench.odometry import attempt, loop
from rbtm_bench.odometry import method as method_module
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.odometry.method import Method, Work
from rbtm_bench.selection.rbtm import Rbtm

# --- time


class Clock:
    """Seconds that pass only when somebody says so, in binary fractions: sums are exact."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    for module in (loop, attempt, method_module):
        monkeypatch.setattr(module, "time", SimpleNamespace(perf_counter=made))
    return made


class SlowCheck(Check):
    """Takes 0.25 s and believes everything."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock

    def reject(self, result: RegistrationResult, T_guess: Array) -> str | None:
        self.clock.now += 0.25
        return None


class SlowWork(Work):
    """Registrations of 4 s and judging of 0.5 s; or known ones that only say 4 s."""

    def __init__(self, method: Method, clock: Clock, reused: bool) -> None:
        super().__init__(method)
        self.clock, self.reused = clock, reused

    def register(
        self, source: Prepared, target: Prepared, T_target_source: Array
    ) -> RegistrationResult:
        result = super().register(source, target, T_target_source)
        self.clock.now += 0.0 if self.reused else 4.5
        return replace(result, seconds=4.0, reused=self.reused)


@pytest.mark.parametrize(("reused", "check_s"), [(False, 0.75), (True, 0.25)])
def test_a_registration_s_time_is_no_check_s_time(
    clock: Clock, reused: bool, check_s: float
) -> None:
    """4 s are the registration's, judging (0.5 s) and the check (0.25 s) the check's; of a known
    registration nothing is taken off the time that did pass."""
    used = method(check=SlowCheck(clock))
    steps = list(odometry(drive(4), used, SlowWork(used, clock, reused)))
    assert [step.record.t_register_s for step in steps] == [0.0, 4.0, 4.0, 4.0]
    assert [step.record.t_check_s for step in steps] == [0.0, *[check_s] * 3]


class SlowToPrepare(Perfect):
    """Takes 2 s to prepare a scan."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self.clock = clock

    def prepare(self, scan: Scan) -> Prepared:
        self.clock.now += 2.0
        return super().prepare(scan)


class SlowScores(Script):
    """Takes 0.5 s to describe a scan and 0.125 s to compare one with a window."""

    def __init__(
        self, clock: Clock, table: dict[Pair, float] | None = None, otherwise: float = 0.9
    ) -> None:
        super().__init__(table, otherwise)
        self.clock = clock

    def describe(self, scan: Scan) -> Array:
        self.clock.now += 0.5
        return super().describe(scan)

    def scores(self, window: Array, descriptor: Array) -> Array:
        self.clock.now += 0.125
        return super().scores(window, descriptor)


def test_every_stage_has_its_own_seconds_and_no_others(clock: Clock) -> None:
    clock.now = 64.0
    used = method(SlowToPrepare(clock), Rbtm(4, threshold=0.5), SlowScores(clock))
    for step in odometry(drive(4), used):
        row = step.record
        assert (row.t_prepare_s, row.t_describe_s, row.t_guess_s) == (2.0, 0.5, 0.0)
        assert row.t_select_s == (0.0 if step.record.scan == 0 else 0.125)


# --- restarts: a window of 4 with fallback "skip"; scans 3, 4, ... look like each other alone


def drive_into_a_new_place(**settings: int) -> tuple[list[Step], Perfect]:
    backend = Perfect()
    table = {(a, b): 0.9 for b in range(1, 12) for a in range(b) if (a < 3) == (b < 3)}
    selector = Rbtm(4, threshold=0.5, fallback="skip", **settings)
    used = method(backend, selector, Script(table, NAN))
    return list(odometry(drive(12), used)), backend


@pytest.mark.parametrize("patience", [1, 3])
def test_a_restart_comes_with_the_first_scan_after_the_patience(patience: int) -> None:
    """Scans 3 ... 2 + patience are left out; the next is matched to the last of these."""
    steps, backend = drive_into_a_new_place(restart_after=patience)
    restarts = [step.record.scan for step in steps if step.record.restart]
    assert restarts == [3 + patience]
    skipped = [step.record.scan for step in steps if step.record.status == "skipped"]
    assert skipped == list(range(3, 3 + patience))
    assert backend.tried[2] == (2 + patience, 3 + patience)


def test_without_a_setting_the_patience_is_what_the_window_counts() -> None:
    """4, the new scan included: 3, 4, 5 and 6 are left out."""
    steps, _ = drive_into_a_new_place()
    assert [step.record.scan for step in steps if step.record.restart] == [7]
    assert [Rbtm(4, restart_after=n).patience for n in (None, 2, 1, 0)] == [4, 2, 1, 1]


def test_a_restart_s_row_tells_of_both_choices(clock: Clock) -> None:
    """Scan 4 looks like 0, which is refused, and like 3, which was left out: two candidates of two
    windows, three scores of which one is undefined, and the time of both."""
    table = {(0, 1): 0.9, (0, 4): 0.9, (3, 4): 0.9}
    selector = Rbtm(3, threshold=0.5, fallback="skip", restart_after=2)
    used = method(Perfect(lost=[(0, 4)]), selector, SlowScores(clock, table, NAN))
    row = list(odometry(drive(5), used))[4].record
    assert (row.restart, row.model, row.registrations, row.rejected) == (True, 3, 2, 1)
    assert (row.candidates, row.undefined_scores, row.t_select_s) == (2, 1, 0.25)


def test_a_refused_registration_tells_how_much_of_the_guess_it_kept() -> None:
    used = replace(method(Perfect(lost=[(0, 1)])), guess_along_degenerate=0.01)
    first, refused, good = list(odometry(drive(3), used))
    assert (refused.record.status, refused.record.kept_guess) == ("predicted", 0)
    assert (first.record.kept_guess, good.record.kept_guess) == (None, 0)


def test_scans_left_out_are_counted_in_a_row() -> None:
    """2 and 4 match nothing, but 3 does: no restart at 5 after one alone, although it is like 4."""
    table = {(0, 1): 0.9, (1, 3): 0.9, (4, 5): 0.9}
    used = method(None, Rbtm(4, 0.5, "skip", restart_after=2), Script(table, NAN))
    steps = list(odometry(drive(6), used))
    told = [(step.record.status, step.record.model) for step in steps]
    assert told[1:] == [
        ("registered", 0),
        ("skipped", None),
        ("registered", 1),
        ("skipped", None),
        ("skipped", None),
    ]
    assert not any(step.record.restart for step in steps)
