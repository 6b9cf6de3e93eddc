"""Several model scans, one pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from loop_helpers import Perfect, Script, drive, method, true_pose

from rbtm_bench.check.gated import Gated
from rbtm_bench.core.geometry import inverse, se2
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.selection.base import Selector
from rbtm_bench.selection.rbtm import Rbtm
from rbtm_bench.selection.rbtm_k import RbtmK
from rbtm_bench.selection.window_graph import WindowGraph


class Off(Perfect):
    """Sure of 1 cm and 0.01 rad, and 0.2 m off in every registration to scan ``wrong``."""

    wrong = -1

    def align(self, source, target, T_target_source):
        given = super().align(source, target, T_target_source)
        off = se2(0.2 if int(target.native) == self.wrong else 0.0, 0, 0)
        T = given.T_target_source @ off
        return replace(given, T_target_source=T, information=1e4 * np.eye(6))


def steps_of(selector: Selector, backend: Perfect | None = None, count: int = 8):
    check = Gated(0.0, 1e3, 180.0)
    way = method(backend or Perfect(), selector, Script(otherwise=0.9), check=check)
    return list(odometry(drive(count), way))


def models(steps) -> list[list[int]]:
    return [[edge.model for edge in step.edges] for step in steps]


def test_the_k_oldest_that_pass() -> None:
    steps = steps_of(RbtmK(edges=2, window=5))
    assert models(steps) == [[], [0], [0, 1], [0, 1], [0, 1], [1, 2], [2, 3], [3, 4]]
    assert [step.record.registrations for step in steps] == [0, 1, 2, 2, 2, 2, 2, 2]
    assert [step.record.model for step in steps[1:]] == [0, 0, 0, 0, 1, 2, 3]
    for scan, step in enumerate(steps):
        np.testing.assert_allclose(
            step.T_world_scan, inverse(true_pose(0)) @ true_pose(scan), atol=1e-9
        )


def test_one_edge_is_rbtm_to_the_bit() -> None:
    one, plain = steps_of(RbtmK(edges=1, window=5)), steps_of(Rbtm(window=5))
    for first, second in zip(one, plain, strict=True):
        assert np.array_equal(first.T_world_scan, second.T_world_scan)
    assert models(one) == models(plain)


def test_all_of_the_window() -> None:
    assert models(steps_of(WindowGraph(window=4), count=6)) == [
        [], [0], [0, 1], [0, 1, 2], [1, 2, 3], [2, 3, 4],
    ]  # fmt: skip


def test_a_rejected_one_is_made_up_for_by_the_next() -> None:
    steps = steps_of(RbtmK(edges=2, window=5), Perfect(fails=[(0, 4)]))
    assert models(steps)[4] == [1, 2]
    assert (steps[4].record.rejected, steps[4].record.registrations) == (1, 3)


@pytest.mark.parametrize("selector", [RbtmK(edges=4, window=6), WindowGraph(window=5)])
def test_one_wrong_edge_does_not_decide(selector) -> None:
    backend, selector.covariance_from = Off(), "own"
    backend.wrong = 2
    steps = steps_of(selector, backend, 7)
    for scan in (5, 6):  # matched to four, scan 2 one of them
        assert 2 in models(steps)[scan]
        off = inverse(inverse(true_pose(0)) @ true_pose(scan)) @ steps[scan].T_world_scan
        assert np.linalg.norm(off[:3, 3]) < 0.02


def test_hops_count_the_edge_that_the_pose_hangs_on() -> None:
    selector = RbtmK(edges=3, window=5)
    assert selector.covariance_from == "localizability"
    assert RbtmK(edges=1).covariance_from is None
