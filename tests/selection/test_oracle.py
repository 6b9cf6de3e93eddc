"""The bound: every candidate registered, truth decides, and nothing else sees it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loop_helpers import Perfect, Script, drive, method, rows, true_pose
from step_helpers import assert_same, steps

from rbtm_bench.calibration.known_pairs import KnownPair, register_all
from rbtm_bench.calibration.measuring import _Kept
from rbtm_bench.cli.commands import main
from rbtm_bench.contract.scene import TinyClouds
from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.geometry import inverse, se2
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array, Node, RegistrationResult, Scan
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.guess.odometry import Odometry
from rbtm_bench.metrics.ape import Ape
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.pairs.shared import KnownScores
from rbtm_bench.pairs.store import PairStore
from rbtm_bench.runs.assembly import check_fit, instantiate
from rbtm_bench.runs.pictures import similarity_matrix
from rbtm_bench.runs.settings import compose_settings
from rbtm_bench.runs.workbench import Workbench
from rbtm_bench.selection.base import Candidate, Trial
from rbtm_bench.selection.oracle import Oracle, rms_displacement
from rbtm_bench.selection.rbtm import Rbtm
from rbtm_bench.similarity import scorematrix
from rbtm_bench.similarity.base import Similarity

POINTS = np.array([[2.0, 0, 0], [0, 2.0, 0], [-2.0, 0, 0], [0, -2.0, 0]])


def test_displacement_by_hand() -> None:
    assert rms_displacement(np.eye(4), POINTS) == 0.0
    assert rms_displacement(se2(3, 4, 0), POINTS) == pytest.approx(5.0)
    # every point is 2 m from the axis: a chord of 2 r sin(angle / 2)
    assert rms_displacement(se2(0, 0, 0.3), POINTS) == pytest.approx(4 * np.sin(0.15))
    assert rms_displacement(se2(0, 0, np.pi), POINTS) == pytest.approx(4.0)


def scan(number: int, truth: Array | None = None) -> Scan:
    return Scan(number, 0.1 * number, POINTS, True, ground_truth=truth)


def trial(model: int, T_world_model: Array, T: Array) -> Trial:
    result = RegistrationResult(T, True, 0.9, 0.01, 4)
    return Trial(Candidate(model, 0.5, "why"), Node(model, 0.0, T_world_model), result)


def seen(**settings: Any) -> Oracle:
    """Truth: 1 m a scan, from a start at (7, 7)."""
    oracle = Oracle(window=9, **settings)
    oracle.window()
    for number in range(5):
        oracle.see(scan(number, se2(7 + number, 7, 0)))
    return oracle


def test_the_pair_or_the_pose() -> None:
    """Model 1 stands where it is and its registration is 20 mm long; model 2 stands 100 mm too
    far and its registration is 95 mm short: a worse measurement, a better pose (5 mm)."""
    trials = [
        trial(1, se2(1.0, 0, 0), se2(2.02, 0, 0)),
        trial(2, se2(2.1, 0, 0), se2(0.905, 0, 0)),
    ]
    which, why = seen().pick(scan(3), trials)
    assert (which, why) == (0, "truth seen: registration 0.0200 m off, best of 2")
    which, why = seen(by="pose").pick(scan(3), trials)
    assert (which, why) == (1, "truth seen: pose 0.0050 m off, best of 2")


def test_the_older_of_equals() -> None:
    trials = [trial(m, se2(m, 0, 0), se2(3 - m + off, 0, 0)) for m, off in ((0, 1), (1, 0), (2, 0))]
    assert seen().pick(scan(3), trials)[0] == 1


def test_it_tries_the_whole_window() -> None:
    oracle = Oracle(window=4)
    window = oracle.window()
    for number in range(6):
        window.push(Node(number, 0.0, np.eye(4)))
    selection = oracle.choose(6, window, np.full(3, np.nan))
    assert [c.model for c in selection.candidates] == [3, 4, 5]
    assert not oracle.needs_scores and selection.undefined == 0


def test_a_scan_without_truth_ends_the_run() -> None:
    with pytest.raises(DataError, match="selector=oracle: scan 3 has no ground truth"):
        Oracle().see(scan(3))


# in the loop


class Skewed(Perfect):
    """Its registration to scan ``good`` is right, all others are off by 50 mm."""

    def __init__(self, good: int, **settings: Any) -> None:
        super().__init__(**settings)
        self.good = good

    def align(self, source, target, T_target_source):
        result = super().align(source, target, T_target_source)
        off = se2(0.0 if target.native == self.good else 0.05, 0, 0)
        return replace(result, T_target_source=result.T_target_source @ off)


def driven(count: int) -> list[Scan]:
    return [replace(s, ground_truth=true_pose(s.index)) for s in drive(count)]


def test_every_candidate_is_registered_and_the_best_taken() -> None:
    backend = Skewed(1)
    steps = list(odometry(driven(4), method(backend, Oracle(9))))
    assert backend.tried == [(0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3)]
    assert rows(steps)[2:] == [("registered", 1), ("registered", 1)]
    row = steps[3].record
    assert (row.registrations, row.candidates, row.rejected) == (3, 3, 0)
    assert row.reason == "truth seen: registration 0.0000 m off, best of 3"


def test_only_what_the_check_accepts() -> None:
    steps = list(odometry(driven(4), method(Skewed(1, lost=[(1, 3)]), Oracle(9))))
    row = steps[3].record
    assert row.model in (0, 2)  # both are off by 50 mm
    assert (row.registrations, row.rejected) == (3, 1)
    assert row.reason.endswith("best of 2")
    lost = [(m, 3) for m in range(3)]
    row = list(odometry(driven(4), method(Skewed(1, lost=lost), Oracle(9))))[3].record
    assert (row.status, row.model, row.reason) == ("predicted", None, "not converged")


@pytest.mark.parametrize("selector", [Oracle(9), Rbtm(9, threshold=0.5)])
def test_nothing_else_sees_the_truth(selector) -> None:
    """Backend, similarity, guess and the oracle's own pick get scans without it."""
    met: list[str] = []

    class Spy(Perfect):
        def prepare(self, scan):
            met.append("backend")
            assert scan.ground_truth is None
            return super().prepare(scan)

    class Peek(Script):
        def describe(self, scan):
            met.append("similarity")
            assert scan.ground_truth is None
            return super().describe(scan)

    class Hint(Odometry):
        def observe(self, scan, prepared, backend):
            met.append("guess")
            assert scan.ground_truth is None
            return 0.0

        def predict(self, model, scan, recent):
            assert scan.ground_truth is None
            assert not any("truth" in name for node in (model, *recent) for name in vars(node))
            return super().predict(model, scan, recent)

    steps = list(odometry(driven(4), method(Spy(), selector, Peek(otherwise=0.9), Hint())))
    assert len(steps) == 4 and met.count("backend") == met.count("guess") == 4


class Blind(Similarity):
    def __init__(self) -> None:
        self.met = 0

    def describe(self, scan):
        self.met += 1
        assert scan.ground_truth is None
        return np.array([float(scan.index)])

    def scores(self, window, descriptor):
        return np.ones(len(window))


def test_nor_does_a_similarity_outside_of_the_loop() -> None:
    """Shared by the runs of a grid, as a matrix, as a run's picture, in a calibration."""
    data, blind = Corridor(scans=3, beams=31), Blind()
    assert data[0].ground_truth is not None
    KnownScores(blind, data)
    assert blind.met == 3
    scorematrix.compute(data, blind, None, 100.0)
    assert blind.met == 7  # the first scan's twice, to know what it needs
    similarity_matrix(data, blind)
    assert blind.met == 10
    kept = _Kept()
    kept.dataset = data
    kept.item(1, blind.describe)
    assert blind.met == 11


def test_nor_does_a_backend_in_a_study_of_pairs() -> None:
    class Blindfolded(Perfect):
        def prepare(self, scan):
            assert scan.ground_truth is None
            return super().prepare(scan)

    target, source = driven(2)
    pair = KnownPair(target, source, inverse(target.ground_truth) @ source.ground_truth, None)
    (outcome,) = register_all(Blindfolded(), [pair], [np.eye(4)])
    assert outcome.metres == pytest.approx(0.0, abs=1e-12)


# in a run

WORDS = ["dataset.scans=40", "selector=oracle", "guess=odometry", "selector.window=6"]


def ape(words: list[str]) -> float:
    parts = instantiate(compose_settings(words))
    steps = list(odometry(parts.dataset, parts.method))
    stamps = np.array([step.record.stamp for step in steps])
    estimate = Trajectory(stamps, np.stack([step.T_world_scan for step in steps]))
    truth = Trajectory(stamps, np.stack([s.ground_truth for s in parts.dataset]))
    value = Ape().evaluate(estimate, truth, None)["ape_rmse_m"]
    assert value is not None
    return value


def test_by_pose_it_bounds_those_that_choose_beforehand() -> None:
    shared = ["dataset.scans=60", "selector.window=12"]
    oracle = ape([*shared, "selector=oracle", "selector.by=pose"])
    for selector in ("rbtm", "oldest", "best", "fewest_hops"):
        assert oracle < ape([*shared, f"selector={selector}"])


@pytest.mark.parametrize("by", ["registration", "pose"])
def test_shared_registrations_give_the_same_bits(by, tmp_path: Path) -> None:
    settings = compose_settings([*WORDS, f"selector.by={by}"])
    plain = steps(instantiate(settings))
    assert all(step.record.reason.startswith("truth seen") for step in plain[1:])
    with PairStore(tmp_path) as store:
        assert_same(plain, steps(Workbench(store).parts(settings)))
        assert_same(plain, steps(Workbench(store).parts(settings)))


def test_no_truth_no_run() -> None:
    with pytest.raises(ConfigError, match=r"dataset=corridor has none: expected .* true pose"):
        check_fit(compose_settings(["selector=oracle"]), TinyClouds())


def test_a_log_without_truth(
    data_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = data_dir / "freiburg" / "aces.clf.gz"
    words = ["selector=oracle", "dataset=carmen", f"dataset.path='{log}'", "dataset.max_scans=9"]
    assert main(["run", *words, f"out='{tmp_path / 'out'}'"]) == 2
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1 and "dataset=carmen" in error and "aces.clf.gz" in error
    assert not (tmp_path / "out").exists()
