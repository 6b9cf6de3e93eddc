"""The candidate with the smallest covariance along its chain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from loop_helpers import Perfect, Script, drive, method

from rbtm_bench.core.geometry import se2
from rbtm_bench.core.types import Node
from rbtm_bench.core.uncertainty import odometry_covariance
from rbtm_bench.guess.constant_velocity import ConstantVelocity
from rbtm_bench.guess.odometry import Odometry
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.runs.assembly import instantiate
from rbtm_bench.runs.settings import compose_settings
from rbtm_bench.selection.least_uncertain import LeastUncertain
from rbtm_bench.selection.rbtm import Rbtm

NAN = float("nan")


@pytest.mark.parametrize(
    ("std", "scores", "expected"),
    [
        ([0.3, 0.1, 0.2], [0.9, 0.9, 0.9], [1, 2, 0]),
        ([0.3, 0.1, 0.2], [0.9, 0.1, NAN], [0]),
        ([0.2, 0.2, 0.1], [0.6, 0.9, 0.3], [0, 1]),  # equals: the older
    ],
)
def test_order(std, scores, expected) -> None:
    selector = LeastUncertain(window=4, threshold=0.5, fallback="skip")
    window = selector.window()
    for scan, s in enumerate(std):
        covariance = np.diag([s**2, 0, 0, 9, 9, 9])  # a turn is no position
        node = Node(scan, 0.0, se2(0, 0, 0), descriptor=np.zeros(1), covariance=covariance)
        window.push(node)
    candidates = selector.choose(3, window, np.array(scores)).candidates
    assert [c.model for c in candidates] == expected
    assert candidates[0].reason == f"{std[expected[0]]:g} m unsure, S > 0.5"


class Informed(Perfect):
    """Perfect, with information: the edge (0, 1) is bad, all others good."""

    def align(self, source, target, T_target_source):
        result = super().align(source, target, T_target_source)
        is_bad = (int(target.native), int(source.native)) == (0, 1)
        information = np.eye(6) * (25.0 if is_bad else 1e4)
        return replace(result, information=information)


def test_a_chain_over_a_bad_edge_is_avoided() -> None:
    """Scan 2 hangs on 0 by a good edge, 1 by a bad one. To scan 3 only 1 and 2 are similar: RBTM
    takes the older."""
    table = {(0, 1): 0.9, (0, 2): 0.9, (1, 3): 0.9, (2, 3): 0.9}
    models = {
        type(selector): [
            step.record.model
            for step in odometry(drive(4), method(Informed(), selector, Script(table)))
        ]
        for selector in (Rbtm(9, threshold=0.5), LeastUncertain(9, threshold=0.5))
    }
    assert models == {Rbtm: [None, 0, 0, 1], LeastUncertain: [None, 0, 0, 2]}


def test_edges_carry_covariances_only_for_who_asks() -> None:
    asked = list(odometry(drive(3), method(Informed(), LeastUncertain(3))))
    assert asked[1].edges[0].covariance is not None
    np.testing.assert_allclose(np.diag(asked[1].edges[0].covariance), [0.04] * 6)
    plain = list(odometry(drive(3), method(Informed(), Rbtm(3))))
    assert plain[1].edges[0].covariance is None


def test_a_prediction_is_as_unsure_as_what_it_is_made_of() -> None:
    """As odometry, where the guess is that; else as unsure as it gets."""
    for guess, expected in ((Odometry(), None), (ConstantVelocity(), np.eye(6))):
        way = method(Perfect(lost=[(0, 1)]), LeastUncertain(2), guess=guess)
        steps = list(odometry(drive(3), way))
        (edge,) = steps[1].edges
        assert edge.kind == "predicted"
        if expected is None:
            expected = odometry_covariance(edge.T_model_scan, False)
        np.testing.assert_array_equal(edge.covariance, expected)


@pytest.mark.parametrize("backend", ["open3d_p2plane", "plicp", "small_gicp_gicp"])
@pytest.mark.parametrize("information", ["own", "localizability"])
def test_a_bare_corridor(backend, information) -> None:
    """Nothing holds the motion along it: information is singular, and a number comes out."""
    words = ["dataset.environment=bare", "dataset.scans=25", "selector=least_uncertain"]
    words += [f"backend={backend}", "selector.window=6", f"selector.information={information}"]
    parts = instantiate(compose_settings(words))
    steps = list(odometry(parts.dataset, parts.method))
    covariances = [step.edges[0].covariance for step in steps[1:]]
    assert all(c is not None and np.isfinite(c).all() for c in covariances)
    assert {step.record.status for step in steps[1:]} <= {"registered", "fallback"}
    if information == "localizability":  # noise makes some normals along it, so not all of 1 m
        assert all(c[0, 0] > 10**2 * c[1, 1] for c in covariances)
