"""The loop with a similarity that reads the initial guess: the right motions, the same bits
shared, and a whole run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rbtm_bench.backends.none import NoRegistration
from rbtm_bench.check.none import AcceptAll
from rbtm_bench.core.geometry import inverse, se2, translation_norm
from rbtm_bench.core.types import Array, Scan, Step
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.guess.base import Guess
from rbtm_bench.guess.constant_velocity import ConstantVelocity
from rbtm_bench.guess.odometry import Odometry, OdometryChained
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.odometry.method import Method
from rbtm_bench.pairs.shared import KnownScores
from rbtm_bench.pairs.store import PairStore
from rbtm_bench.runs import assembly, experiment
from rbtm_bench.runs.settings import compose_settings
from rbtm_bench.runs.workbench import Workbench
from rbtm_bench.selection.rbtm import Rbtm
from rbtm_bench.similarity.base import Similarity
from rbtm_bench.similarity.overlap import Overlap
from rbtm_bench.target.single import SingleScan

TIMES = ("t_prepare_s", "t_describe_s", "t_guess_s", "t_select_s", "t_register_s", "t_check_s")


class Listening(Similarity):
    """Scores how near the guessed place is, and keeps what it was asked."""

    needs_guess = True

    def __init__(self) -> None:
        self.asked: list[tuple[list[int], int, Array]] = []

    def describe(self, scan: Scan) -> Array:
        return np.array([float(scan.index)])

    def scores(self, window: Array, descriptor: Array) -> Array:
        raise AssertionError("the loop has a guess: scores under no motion are not asked for")

    def scores_under(self, window: Array, descriptor: Array, motions: Array) -> Array:
        self.asked.append((window[:, 0].astype(int).tolist(), int(descriptor[0]), motions))
        return 1.0 - translation_norm(motions)


def drive(count: int) -> list[Scan]:
    poses = [se2(0.1 * i, 0.02 * i**2, 0.05 * i) for i in range(count)]
    return [Scan(i, 0.1 * i, np.ones((10, 3)), odometry=T) for i, T in enumerate(poses)]


def method(similarity: Similarity, guess: Guess, selector: Rbtm) -> Method:
    return Method(NoRegistration(), similarity, selector, guess, AcceptAll(), SingleScan())


@pytest.mark.parametrize("guess", [Odometry(), OdometryChained(), ConstantVelocity()])
def test_every_member_of_the_window_comes_with_its_guess(guess) -> None:
    similarity = Listening()
    scans = drive(7)
    steps = list(odometry(scans, method(similarity, guess, Rbtm(window=4, threshold=0.5))))
    poses = [step.T_world_scan for step in steps]
    assert [(models, scan) for models, scan, _ in similarity.asked] == [
        (list(range(max(0, scan - 3), scan)), scan) for scan in range(1, 7)
    ]
    for models, scan, motions in similarity.asked:
        if isinstance(guess, ConstantVelocity):
            step = inverse(poses[scan - 2]) @ poses[scan - 1] if scan > 1 else np.eye(4)
            expected = [inverse(poses[m]) @ poses[scan - 1] @ step for m in models]
        else:  # this odometry is the truth, and so is the trajectory made of it
            expected = [inverse(scans[m].odometry) @ scans[scan].odometry for m in models]
        np.testing.assert_allclose(motions, expected, atol=1e-12)


def test_the_model_scan_is_the_oldest_that_the_guess_finds_similar() -> None:
    """Scans 0.1 m apart along a line; 1 - distance must exceed 0.75: two scans back."""
    scans = [Scan(i, 0.0, np.ones((10, 3)), odometry=se2(0.1 * i, 0, 0)) for i in range(6)]
    chosen = method(Listening(), Odometry(), Rbtm(window=5, threshold=0.75))
    steps = list(odometry(scans, chosen))
    assert [step.record.model for step in steps] == [None, 0, 0, 1, 2, 3]
    assert [step.record.score for step in steps[2:]] == pytest.approx([0.8] * 4)


def test_the_guess_s_time_is_the_guess_s() -> None:
    steps = list(odometry(drive(5), method(Listening(), Odometry(), Rbtm(window=4))))
    assert steps[0].record.t_guess_s == 0.0
    assert all(step.record.t_guess_s > 0.0 for step in steps[1:])


def test_a_similarity_without_motions_gets_none() -> None:
    """A plain plug-in knows nothing of ``scores_under``."""

    class Plain(Similarity):
        def describe(self, scan: Scan) -> Array:
            return np.array([float(scan.index)])

        def scores(self, window: Array, descriptor: Array) -> Array:
            return np.full(len(window), 0.9)

    steps = list(odometry(drive(4), method(Plain(), Odometry(), Rbtm(window=3))))
    assert [step.record.score for step in steps[1:]] == [0.9] * 3
    assert all(step.record.t_guess_s == 0.0 for step in steps)
    descriptors = np.arange(3.0)[:, None]
    still = np.tile(np.eye(4), (3, 1, 1))
    np.testing.assert_array_equal(Plain().scores_under(descriptors, descriptors[0], still), 0.9)


def test_no_band_of_scores_that_nobody_asks_for() -> None:
    """A whole log's scores under no motion would be work for nothing."""

    class Thrifty(Listening):
        def band(self, descriptors: Array, window: int) -> Array:
            raise AssertionError("a band is of no use where every run has its own guess")

    shared = KnownScores(Thrifty(), Corridor(scans=5, beams=31))
    shared.widen(3)
    assert shared._band.width == 0


# --- whole runs on the paper's corridor

FEWER = "dataset.beams=341"
RUN = ["dataset.scans=40", "selector=rbtm", "selector.window=16"]
RUNS = {
    "overlap": ["similarity=overlap", "similarity.radius=0.05", "selector.threshold=0.9"],
    "odometry": ["similarity=overlap", "guess=odometry", "selector.threshold=0.95"],
    "chain": ["similarity=overlap", "guess=chain", "selector.threshold=0.95"],
    "keyframes": ["similarity=overlap", "selector.content=keyframes", "selector.threshold=0.9"],
    "best": ["similarity=overlap", "selector.fallback=best", "selector.threshold=0.999"],
    "mutual": ["similarity=mutual_neighbours", "selector.threshold=0.5"],
    "ranges": ["similarity=range_correlation", "selector.threshold=0.9"],
}


def rows(run: list[Step]) -> list[dict[str, Any]]:
    exempt = (*TIMES, "reused")
    return [{k: v for k, v in s.record.as_dict().items() if k not in exempt} for s in run]


@pytest.mark.parametrize("name", RUNS)
def test_serial_and_shared_runs_are_the_same_bits(name: str, tmp_path: Path) -> None:
    settings = compose_settings([*RUN, *RUNS[name]])
    parts = assembly.instantiate(settings)
    plain = list(odometry(parts.dataset, parts.method))
    with PairStore(tmp_path) as store:
        bench = Workbench(store)
        other = compose_settings([*RUN, *RUNS[name], "selector.window=6"])
        for config in (settings, other, settings):
            again = bench.parts(config)
            run = list(odometry(again.dataset, again.method, again.work))
    np.testing.assert_equal(rows(run), rows(plain))
    for a, b in zip(run, plain, strict=True):
        assert a.T_world_scan.tobytes() == b.T_world_scan.tobytes()
    assert len({step.record.gap for step in plain[1:]}) > 1, "similarity decided nothing"


def test_a_run_end_to_end(tmp_path: Path) -> None:
    """The scores in the rows are the overlap under the run's own guess, and RBTM with them ends
    nearer than the previous scan does."""
    settings = compose_settings([FEWER, "selector=rbtm", *RUNS["overlap"], "selector.window=64"])
    record = experiment.run(settings, tmp_path / "overlap")
    assert record["status"] == "done"
    parts = assembly.instantiate(settings)
    steps = list(odometry(parts.dataset, parts.method))
    similarity, scans = Overlap(radius=0.05), list(parts.dataset)
    for step in steps[2::20]:
        T = [steps[step.record.scan - k].T_world_scan for k in (1, 2)]
        model = step.record.model
        guess = inverse(steps[model].T_world_scan) @ T[0] @ (inverse(T[1]) @ T[0])
        described = [similarity.describe(scans[i]) for i in (model, step.record.scan)]
        expected = similarity.scores_under(described[0][None], described[1], guess[None])[0]
        assert step.record.score == pytest.approx(expected, abs=1e-12)
    sticking = compose_settings([FEWER, "selector=previous"])
    experiment.run(sticking, tmp_path / "previous")
    errors = {}
    for name in ("overlap", "previous"):
        estimate = np.loadtxt(tmp_path / name / "trajectory.tum")
        truth = np.loadtxt(tmp_path / name / "ground_truth.tum")
        errors[name] = np.hypot(*(estimate - truth)[-1, 1:3])
    assert errors["overlap"] < 0.5 * errors["previous"], errors
    scores = np.load(tmp_path / "overlap" / "similarity.npz")["scores"]
    assert scores.shape == (181, 181) and (np.diag(scores) == 1.0).all()
