"""The loop with a fake backend and scripted scores: every decision, step by step."""

from __future__ import annotations

import inspect
import weakref
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from loop_helpers import Perfect, Script, drive, method, rows, true_pose

from rbtm_bench.check.none import AcceptAll
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Scan
from rbtm_bench.guess.constant_velocity import ConstantVelocity
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.selection.oldest import Oldest
from rbtm_bench.selection.previous import Previous
from rbtm_bench.selection.rbtm import Rbtm
from rbtm_bench.target.local_map import LocalMap


def test_sequential_registration() -> None:
    steps = list(odometry(drive(4), method()))
    assert rows(steps) == [("first", None), *[("registered", i) for i in range(3)]]
    assert steps[0].edges == () and np.array_equal(steps[0].T_world_scan, np.eye(4))
    row = steps[2].record
    assert (row.scan, row.stamp, row.gap, row.registrations, row.rejected) == (2, 0.2, 1, 1, 0)
    assert (row.converged, row.fitness, row.iterations) == (True, 1.0, 3)
    assert row.inlier_rmse_m == pytest.approx(0.0, abs=1e-12)
    assert (row.library_fitness, row.library_rmse_m) == (0.8, None)


@pytest.mark.parametrize("selector", [Previous(), Oldest(4), Rbtm(window=6, threshold=0.5)])
def test_poses_are_the_chain_of_edges(selector) -> None:
    """Perfect motions, whatever the model scan: the true path, from its first pose."""
    steps = list(odometry(drive(9, first=3), method(selector=selector)))
    poses = {step.record.scan: step.T_world_scan for step in steps}
    for step in steps[1:]:
        (edge,) = step.edges
        assert (edge.kind, edge.scan, edge.model) == (
            "registered",
            step.record.scan,
            step.record.model,
        )
        chained = poses[edge.model] @ edge.T_model_scan
        np.testing.assert_allclose(poses[edge.scan], chained, atol=1e-12)
        truth = inverse(true_pose(3)) @ true_pose(edge.scan)
        np.testing.assert_allclose(poses[edge.scan], truth, atol=1e-12)


def test_figure_2_of_the_paper() -> None:
    """w = 4: S_13 passes, S_14 is exactly Th, S_24 passes. The path of 4 reads 1 -> 2 -> 4."""
    table = {(1, 2): 0.9, (1, 3): 0.8, (2, 3): 0.9, (1, 4): 0.7, (2, 4): 0.8, (3, 4): 0.9}
    backend = Perfect()
    steps = list(
        odometry(drive(4, first=1), method(backend, Rbtm(4, threshold=0.7), Script(table)))
    )
    models = {step.record.scan: step.record.model for step in steps}
    path = [4]
    while (model := models[path[-1]]) is not None:
        path.append(model)
    assert path == [4, 2, 1]
    assert backend.tried == [(1, 2), (1, 3), (2, 4)]
    assert [s.record.score for s in steps[1:]] == [0.9, 0.8, 0.8]
    assert [s.record.candidates for s in steps] == [0, 1, 2, 2]


@pytest.mark.parametrize("how", ["fails", "lost"])
def test_a_rejection_leads_to_the_next_candidate(how) -> None:
    """The library raises, or the check refuses: both count as rejected."""
    backend = Perfect(**{how: [(0, 4), (1, 4)]})
    steps = list(odometry(drive(5), method(backend, Rbtm(9, threshold=0.5))))
    row = steps[4].record
    assert backend.tried[-3:] == [(0, 4), (1, 4), (2, 4)]
    assert (row.status, row.model, row.gap) == ("registered", 2, 2)
    assert (row.candidates, row.registrations, row.rejected) == (4, 3, 2)
    assert row.reason == "S > 0.5"


def test_then_to_the_fallback() -> None:
    """0 and 1 pass and are rejected; the newest, 3, has no score but is the last resort."""
    table = {(0, 4): 0.9, (1, 4): 0.8}
    backend = Perfect(lost=table)
    selector = Rbtm(9, threshold=0.5)
    steps = list(odometry(drive(5), method(backend, selector, Script(table))))
    row = steps[4].record
    assert backend.tried[-3:] == [(0, 4), (1, 4), (3, 4)]
    assert (row.status, row.model, row.reason) == ("fallback", 3, "fallback previous")
    assert (row.candidates, row.registrations, row.rejected) == (2, 3, 2)
    assert row.score is not None and np.isnan(row.score)


def test_then_to_the_guess() -> None:
    """Everything is rejected: the scan moves on from the previous one by the guess."""
    backend = Perfect(lost=[(2, 3)])
    scans = drive(5)
    steps = list(odometry(scans, method(backend)))
    row, (edge,) = steps[3].record, steps[3].edges
    assert (row.status, row.model, row.gap, row.reason) == (
        "predicted",
        None,
        None,
        "not converged",
    )
    assert (row.rejected, row.registrations, row.fitness) == (1, 1, None)
    assert (edge.kind, edge.model, edge.scan) == ("predicted", 2, 3)
    step = inverse(scans[2].odometry) @ scans[3].odometry
    np.testing.assert_allclose(edge.T_model_scan, step, atol=1e-12)
    np.testing.assert_allclose(steps[3].T_world_scan, steps[2].T_world_scan @ step, atol=1e-12)
    assert rows(steps)[4] == ("registered", 3), "a predicted scan may be a model scan"


def test_a_skipped_scan_keeps_its_predicted_pose_and_is_never_a_model() -> None:
    """No score for scan 2. Scans 3 and 4 find everything similar but it."""
    table = {pair: 0.9 for pair in [(0, 1), (0, 3), (1, 3), (2, 3), (0, 4), (1, 4), (2, 4), (3, 4)]}
    backend = Perfect(lost=[(0, 4), (1, 4)])
    scans = drive(5)
    steps = list(
        odometry(scans, method(backend, Rbtm(9, threshold=0.5, fallback="skip"), Script(table)))
    )
    assert rows(steps)[2:] == [("skipped", None), ("registered", 0), ("registered", 3)]
    assert 2 not in {model for model, _ in backend.tried}
    row, (edge,) = steps[2].record, steps[2].edges
    assert (row.candidates, row.registrations, row.rejected) == (0, 0, 0)
    assert (edge.kind, edge.model) == ("predicted", 1)
    step = inverse(scans[1].odometry) @ scans[2].odometry
    np.testing.assert_allclose(steps[2].T_world_scan, steps[1].T_world_scan @ step, atol=1e-12)


def test_an_unusable_scan_in_mid_run() -> None:
    backend = Perfect(unusable=[2])
    steps = list(odometry(drive(5), method(backend)))
    assert rows(steps)[1:] == [
        ("registered", 0),
        ("unusable", None),
        ("registered", 1),
        ("registered", 3),
    ]
    assert steps[2].record.reason == "scan 2: 2 points"
    assert steps[2].edges[0].kind == "predicted"
    assert steps[2].record.registrations == 0


def test_an_unusable_first_scan() -> None:
    """It is the origin all the same; the next one has no model scan yet."""
    backend = Perfect(unusable=[0])
    steps = list(odometry(drive(4), method(backend)))
    assert rows(steps) == [
        ("unusable", None),
        ("predicted", None),
        ("registered", 1),
        ("registered", 2),
    ]
    assert steps[1].record.reason == "no model scan yet"
    assert np.array_equal(steps[0].T_world_scan, np.eye(4))


def test_nothing_usable_at_all() -> None:
    steps = list(odometry(drive(4), method(Perfect(unusable=range(4)), guess=ConstantVelocity())))
    assert {status for status, _ in rows(steps)} == {"unusable"}
    np.testing.assert_allclose([s.T_world_scan for s in steps], [np.eye(4)] * 4, atol=1e-12)


def test_no_scans_no_steps() -> None:
    assert list(odometry([], method())) == []


def test_a_target_that_cannot_be_built_is_a_rejection() -> None:
    backend = Perfect()
    steps = list(odometry(drive(3), method(backend, target=LocalMap(1))))
    assert [s.record.status for s in steps] == ["first", "predicted", "predicted"]
    assert (steps[2].record.rejected, steps[2].record.reason) == (1, "no maps here")
    assert backend.calls == []


def test_the_backend_starts_from_the_guess() -> None:
    backend, scans = Perfect(), drive(6)
    list(odometry(scans, method(backend, Oldest(4))))
    assert [model for model, _ in backend.tried] == [0, 0, 0, 1, 2]
    for model, scan, T in backend.calls:
        expected = inverse(scans[model].odometry) @ scans[scan].odometry
        np.testing.assert_allclose(T, expected, atol=1e-12)


def test_constant_velocity_follows_the_estimate() -> None:
    """The previous motion again, from the estimated poses; nothing before the second scan."""
    backend = Perfect()
    steps = list(odometry(drive(5), method(backend, guess=ConstantVelocity(), check=AcceptAll())))
    poses = [step.T_world_scan for step in steps]
    np.testing.assert_allclose(backend.calls[0][2], np.eye(4), atol=1e-12)
    for scan in (2, 3, 4):
        last = inverse(poses[scan - 2]) @ poses[scan - 1]
        np.testing.assert_allclose(backend.calls[scan - 1][2], last, atol=1e-12)


def test_undefined_scores_are_counted() -> None:
    table = {(0, 3): 0.9, (2, 3): 0.1}
    steps = list(odometry(drive(4), method(None, Rbtm(9, threshold=0.5), Script(table))))
    assert [s.record.undefined_scores for s in steps] == [0, 1, 2, 1]


def test_a_strategy_without_scores_describes_nothing() -> None:
    similarity = Script()
    steps = list(odometry(drive(4), method(selector=Oldest(3), similarity=similarity)))
    assert similarity.described == []
    assert [s.record.undefined_scores for s in steps] == [0] * 4


def test_every_scan_is_described_once() -> None:
    similarity = Script()
    list(odometry(drive(5), method(selector=Rbtm(3), similarity=similarity)))
    assert similarity.described == [0, 1, 2, 3, 4]


def test_keyframes_in_the_window_and_every_scan_registered() -> None:
    """0.25 m from the last: keyframes are 0, 3 and 5, two of them beside the new scan."""
    selector = Rbtm(window=3, threshold=0.5, content="keyframes", keyframe_distance=0.25)
    steps = list(odometry(drive(7), method(selector=selector)))
    assert [s.record.status for s in steps[1:]] == ["registered"] * 6
    assert [s.record.model for s in steps[1:]] == [0, 0, 0, 0, 0, 3]


@pytest.mark.parametrize("backend", [Perfect(), Perfect(lost=[(1, 2)], unusable=[3])])
def test_times_are_never_negative(backend) -> None:
    for step in odometry(drive(6), method(backend, Rbtm(4))):
        row = step.record.as_dict()
        stages = [name for name in row if name.startswith("t_")]
        assert len(stages) == 6 and row["search_seconds"] is None
        assert all(row[stage] >= 0.0 for stage in stages)


def test_scans_are_taken_one_at_a_time() -> None:
    """A sensor's stream: each scan is answered before the next one is asked for."""
    taken = []

    def stream() -> Iterator[Scan]:
        for scan in drive(6):
            taken.append(scan.index)
            yield scan

    for number, step in enumerate(odometry(stream(), method(selector=Rbtm(4)))):
        assert taken == list(range(number + 1))
        assert step.record.scan == number


@pytest.mark.parametrize("capacity", [1, 5])
def test_memory_does_not_grow(capacity) -> None:
    """Scans die when they leave the loop, what was prepared of them when it leaves the window."""
    scans: list[weakref.ref[Any]] = []
    clouds: list[weakref.ref[Any]] = []

    def stream() -> Iterator[Scan]:
        for i in range(40):
            scan = drive(1, first=i)[0]
            scans.append(weakref.ref(scan))
            clouds.append(weakref.ref(scan.points))
            yield scan

    for _ in odometry(stream(), method(selector=Rbtm(capacity + 1))):
        assert sum(ref() is not None for ref in scans) <= 2
        # the window, the two most recent scans and the one in hand
        assert sum(ref() is not None for ref in clouds) <= capacity + 3
    assert len(scans) == 40


def test_the_loop_fits_a_screen() -> None:
    assert len(inspect.getsource(odometry).splitlines()) <= 60
