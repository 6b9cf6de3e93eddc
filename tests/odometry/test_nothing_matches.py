"""Scans that match nothing: left out, found again, and never skipped for ever."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loop_helpers import NAN, Pair, Perfect, Script, drive, method, rows
from step_helpers import assert_same
from step_helpers import steps as all_steps
from sweep_helpers import script

from rbtm_bench.core.geometry import inverse, rotation_angle, se2, translation_norm
from rbtm_bench.core.types import Array, Node, Step, StepTable
from rbtm_bench.metrics.summary import summarise_steps
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.pairs.store import PairStore
from rbtm_bench.runs.assembly import instantiate
from rbtm_bench.runs.settings import compose_settings
from rbtm_bench.runs.workbench import Workbench
from rbtm_bench.selection.previous import Previous
from rbtm_bench.selection.rbtm import Rbtm
from rbtm_bench.selection.window import Keyframes, Window

SCRIPT = script("nothing_matches")
Event = SCRIPT.Event

# the rules, on scripted scores


def places(names: str) -> dict[Pair, float]:
    """Scores of scans taken at places: "aab" is alike, alike, strange; "?" is like nothing."""
    return {
        (model, scan): 0.9 if names[model] == names[scan] != "?" else 0.1
        for scan in range(len(names))
        for model in range(scan)
    }


def drive_through(names: str, backend: Perfect | None = None, **settings) -> list[Step]:
    selector = Rbtm(threshold=0.5, **{"window": 4, "fallback": "skip", **settings})
    used = method(backend or Perfect(), selector, Script(places(names), NAN))
    return list(odometry(drive(len(names)), used))


def told(steps: list[Step]) -> str:
    """A letter a scan: registered, skipped, predicted; R for a restart."""
    return "".join("R" if s.record.restart else s.record.status[0] for s in steps)


def test_without_a_restart_a_new_place_is_skipped_for_ever() -> None:
    steps = drive_through("aaa" + 20 * "b", restart_after=1000)
    assert told(steps) == "frr" + 20 * "s"


def test_a_new_place_is_taken_up_after_as_many_scans_as_the_window_counts() -> None:
    """4 scans are left out; the fifth is matched to the fourth, and both are model scans."""
    steps = drive_through("aaabbbbbbb")
    assert told(steps) == "frrssssRrr"
    assert [s.record.model for s in steps[7:]] == [6, 6, 6]
    assert (steps[7].record.reason, steps[7].record.gap) == ("restart: S > 0.5", 1)
    assert steps[7].edges[0].kind == "registered"


@pytest.mark.parametrize("patience", [1, 2, 5])
def test_the_patience_is_a_setting(patience) -> None:
    steps = drive_through("aaabbbbbbb", restart_after=patience)
    assert told(steps) == "frr" + patience * "s" + "R" + (6 - patience) * "r"


def test_patience_starts_anew_after_a_match() -> None:
    assert told(drive_through("aabbabbaccc", restart_after=3)) == "frssrssrsss"
    assert told(drive_through("aabbabbacccc", restart_after=3)) == "frssrssrsssR"


def test_noise_is_never_a_model_scan_however_long_it_lasts() -> None:
    steps = drive_through("aaa" + 50 * "?" + "aabb")
    assert told(steps) == "frr" + 50 * "s" + "rrss"
    assert not {s.record.model for s in steps} & set(range(3, 53))


def test_nor_what_the_check_rejects() -> None:
    """Scan 3 looks like 0, 1 and 2 and fits none of them: with skip it is left out as well."""
    backend = Perfect(lost=[(0, 3), (1, 3), (2, 3), (0, 5), (1, 5), (2, 5)])
    steps = drive_through("aaaaaa", backend, window=9)
    assert told(steps) == "frrprr"
    assert steps[5].record.model == 4 and (3, 5) not in backend.tried
    row = steps[3].record
    assert (row.status, row.reason, row.rejected) == ("predicted", "not converged", 3)


def test_a_restart_is_checked_as_well() -> None:
    backend = Perfect(lost=[(4, 5)])
    steps = drive_through("aaabbbb", backend, restart_after=2)
    assert told(steps) == "frrsspR"
    assert steps[5].record.rejected == 1 and steps[6].record.model == 5


def test_a_restart_hangs_on_the_predicted_pose() -> None:
    """Odometry over the gap, the measurement from there on."""
    scans = drive(8)
    steps = drive_through("aaabbbbb", restart_after=3)
    assert told(steps) == "frrsssRr"
    before, last, now = (steps[i].T_world_scan for i in (2, 5, 6))
    by_odometry = inverse(scans[2].odometry) @ scans[5].odometry
    np.testing.assert_allclose(inverse(before) @ last, by_odometry, atol=1e-12)
    np.testing.assert_allclose(inverse(last) @ now, steps[6].edges[0].T_model_scan, atol=1e-12)


def test_unusable_scans_are_waited_for() -> None:
    """Nothing can be matched to a scan that could not be prepared."""
    steps = drive_through("aaabbbbb", Perfect(unusable=[4, 5]), restart_after=2)
    assert told(steps) == "frrsuusR"
    assert steps[7].record.model == 6


def test_other_fallbacks_know_no_restart() -> None:
    steps = drive_through("aaabbbbbbb", fallback="previous", restart_after=1)
    assert told(steps) == "frrfrrrrrr"
    lost = [(i, i + 1) for i in range(2, 6)]
    steps = list(odometry(drive(8), method(Perfect(lost=lost), Previous())))
    assert rows(steps)[3:] == [("predicted", None)] * 4 + [("registered", 6)]


def test_a_keyframe_window_takes_the_restarts_model_whatever_its_distance() -> None:
    """0.1 m a scan: the restart at scan 5 is 0.2 m from the last keyframe 0, and lasts."""
    wide = {"content": "keyframes", "keyframe_distance": 50.0, "keyframe_angle_deg": 179.0}
    steps = drive_through("aaabbbbb", restart_after=2, **wide)
    assert told(steps) == "frrssRrr"
    assert [s.record.model for s in steps[5:]] == [4, 4, 4]


def test_always_into_the_window() -> None:
    window = Window(3, Keyframes(1.0, 10.0))
    for scan, always in ((0, False), (1, False), (2, True), (3, False)):
        window.push(Node(scan, 0.0, se2(0, 0, 0)), always=always)
    assert window.scans.tolist() == [0, 2]


# on data, end to end


GAP, NOISE = 0, 1


def motion(steps: list[Step], a: int, b: int) -> Array:
    """From scan number a to scan number b."""
    poses = SCRIPT.poses_of(steps)
    return inverse(poses[a]) @ poses[b]


class Log:
    """A data set, what happens to it, and the runs made of it so far."""

    def __init__(self, words: list[str], events: list[Any], longest: float) -> None:
        self.words, self.events, self.longest = words, events, longest
        self._runs: dict[tuple[int, str], list[Step]] = {}

    def run(self, event: int, name: str) -> list[Step]:
        """By a fallback, or by the guess alone."""
        if (event, name) not in self._runs:
            more = SCRIPT.METHODS.get(name, SCRIPT.GUESS_ALONE)
            steps = SCRIPT.run([*self.words, *more], self.events[event], self.longest)
            self._runs[event, name] = steps
        return self._runs[event, name]


@pytest.fixture(scope="module", params=["corridor", "aces"])
def log(request: pytest.FixtureRequest) -> Log:
    """The simulated corridor, always, and the beginning of ACES."""
    if request.param == "corridor":
        return Log(SCRIPT.CORRIDOR, SCRIPT.CORRIDOR_EVENTS, 4.0)
    return Log(SCRIPT.aces_words(request.getfixturevalue("data_dir")), SCRIPT.ACES_EVENTS, 8.0)


def is_held(step: Step) -> bool:
    """Registered, or the first."""
    return step.record.status in ("first", "registered")


def test_a_gap(log: Log) -> None:
    """What comes after it is not in the window: predicted, then taken up again."""
    gap, steps = log.events[GAP], log.run(GAP, "skip")
    after = [step for step in steps if step.record.scan >= gap.last]
    restart = next(i for i, step in enumerate(after) if step.record.restart)
    assert {s.record.status for s in after[:restart]} <= {"skipped", "predicted"}
    known = after[restart].record.model
    assert known == after[restart - 1].record.scan
    # until the restart poses are the odometry's over the gap, neither better nor worse
    last = next(s.record.scan for s in reversed(steps) if s.record.scan < gap.first and is_held(s))
    guessed = motion(log.run(GAP, "guess alone"), last, known)
    difference = inverse(guessed) @ motion(steps, last, known)
    assert translation_norm(difference) < 1e-9 and rotation_angle(difference) < 1e-9
    assert summarise_steps(StepTable(s.record for s in after[restart:]))["coverage"] > 0.75


def test_noise(log: Log) -> None:
    """Ten scans of nothing: skipped, models of none, and after them registration goes on."""
    noise, steps = log.events[NOISE], log.run(NOISE, "skip")
    ten = range(noise.first, noise.last)
    bad = [step for step in steps if step.record.scan in ten]
    assert len(bad) == 10
    assert {step.record.status for step in bad} <= {"skipped", "predicted"}
    assert {step.edges[0].kind for step in bad} == {"predicted"}
    assert not {step.record.model for step in steps} & set(ten)
    rest = [step.record for step in steps if step.record.scan >= noise.last]
    assert summarise_steps(StepTable(rest))["coverage"] > 0.7
    # with a fallback that always has an answer and a bound on fitness alone, noise is matched to;
    # the check against recent registrations sees it where noise fits worse than scans do
    assert {step.record.model for step in log.run(NOISE, "previous, check=gated")} & set(ten)
    if log.words is not SCRIPT.CORRIDOR:
        assert not {step.record.model for step in log.run(NOISE, "previous")} & set(ten)


def test_endless_skipping_and_its_end(log: Log) -> None:
    """Without restarts the gap is the end of it: half of the log and more is never registered."""
    starved = log.run(GAP, "skip, no restart")
    sums = summarise_steps(StepTable(step.record for step in starved))
    assert sums["coverage"] < 0.5 and sums["longest_skip"] > 100 and sums["restarts"] == 0
    sums = summarise_steps(StepTable(step.record for step in log.run(GAP, "skip")))
    assert sums["coverage"] > 0.8 and sums["longest_skip"] < 30 and sums["restarts"] >= 1


def test_shared_work_gives_the_same_restarts(tmp_path: Path) -> None:
    words = ["dataset.environment=l_turn", "dataset.scans=40", "guess=odometry", "selector=rbtm"]
    words += ["selector.fallback=skip", "selector.threshold=0.9", "selector.window=4"]
    settings = compose_settings(words)
    plain = all_steps(instantiate(settings))
    assert any(step.record.restart for step in plain)
    with PairStore(tmp_path) as store:
        assert_same(plain, all_steps(Workbench(store).parts(settings)))


def test_the_script_prints_a_row_for_every_case(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("RBTM_BENCH_DATA", raising=False)
    assert "RBTM_BENCH_DATA" not in os.environ
    few = ["dataset.scans=31", "dataset.beams=91", "dataset.environment=l_turn", "guess=odometry"]
    monkeypatch.setattr(SCRIPT, "CORRIDOR", few)
    monkeypatch.setattr(SCRIPT, "CORRIDOR_EVENTS", [Event("3 of noise", 7, 10)])
    assert SCRIPT.main() == 0
    head, rule, *lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 * len(SCRIPT.METHODS)
    assert {line.count("|") for line in (head, rule, *lines)} == {11}
