"""Pose graphs: derivatives against differences, optima by hand and against a dense reference."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from rbtm_bench.core.geometry import inverse, se2, se3, translation_norm
from rbtm_bench.core.types import Array
from rbtm_bench.graph.motions import moved, small
from rbtm_bench.graph.optimise import optimise
from rbtm_bench.graph.pose_graph import PoseGraph
from rbtm_bench.graph.robust import dcs

RNG = np.random.default_rng


def graph_of(poses, edges, planar=True, information=None, loops=()) -> PoseGraph:
    """A graph of edges (model, scan, T); ``loops`` are the places of those that may be wrong."""
    ends = np.array([edge[:2] for edge in edges], dtype=np.int64)
    wrong = np.isin(np.arange(len(edges)), loops)
    if information is None:
        information = np.tile(np.eye(6), (len(edges), 1, 1))
    motions = np.stack([edge[2] for edge in edges])
    scans = np.arange(len(poses))
    return PoseGraph(scans, np.stack(poses), ends, motions, information, wrong, planar)


def random_pose(rng, planar: bool, size: float = 1.0) -> Array:
    if planar:
        return se2(*rng.normal(0, size, 3))
    return se3(rng.normal(0, size, 3), Rotation.from_rotvec(rng.normal(0, size, 3)).as_matrix())


def random_information(rng, count: int) -> Array:
    A = rng.normal(0, 1, (count, 6, 6))
    return A @ np.swapaxes(A, 1, 2) + np.eye(6)


def random_graph(seed: int, planar: bool, nodes: int = 7, noise: float = 0.05) -> PoseGraph:
    """A chain and three loops, each edge off by ``noise``; poses start from the chain."""
    rng = RNG(seed)
    truth = [np.eye(4)]
    for _ in range(nodes - 1):
        truth.append(truth[-1] @ random_pose(rng, planar, 0.6))
    pairs = [(i, i + 1) for i in range(nodes - 1)] + [(0, 4), (1, 6), (2, 5)]
    edges = [
        (i, j, inverse(truth[i]) @ truth[j] @ random_pose(rng, planar, noise)) for i, j in pairs
    ]
    poses = [np.eye(4)]
    for _, _, T in edges[: nodes - 1]:
        poses.append(poses[-1] @ T)
    return graph_of(poses, edges, planar, random_information(rng, len(edges)))


@pytest.mark.parametrize("planar", [True, False])
@pytest.mark.parametrize("noise", [0.0, 1e-6, 0.05, 0.8])
def test_derivatives_are_those_of_differences(planar, noise) -> None:
    graph = random_graph(3, planar, noise=noise)
    e, by_model, by_scan = graph.linearised()
    np.testing.assert_array_equal(e, graph.residuals())
    step = 1e-6
    for column, axis in enumerate(graph.axes):
        for side, derivative in ((0, by_model), (1, by_scan)):
            for edge in range(len(graph.ends)):
                off = []
                for sign in (1, -1):
                    d = np.zeros((len(graph.scans), 6))
                    d[graph.ends[edge, side], axis] = sign * step
                    poses = moved(graph.T_world_scan, d)
                    off.append(graph.at(poses).residuals()[edge])
                numeric = (off[0] - off[1]) / (2 * step)
                np.testing.assert_allclose(derivative[edge, :, column], numeric, atol=2e-8)


def test_small_motions_are_read_off_as_applied() -> None:
    d = RNG(0).normal(0, 0.7, (20, 6))
    T = moved(np.tile(np.eye(4), (20, 1, 1)), d)
    np.testing.assert_allclose(small(T), d, atol=1e-12)


def test_three_nodes_by_hand() -> None:
    """0 -> 1 -> 2 says 2 m, the loop 0 -> 2 says 2.3 m, all equally sure: each takes a third of
    the 0.3 m. With the loop four times as sure, the two share 0.3 m less what it gives: 4 l = s,
    2 s + l = 0.3."""
    poses = [se2(0, 0, 0), se2(1, 0, 0), se2(2, 0, 0)]
    edges = [(0, 1, se2(1, 0, 0)), (1, 2, se2(1, 0, 0)), (0, 2, se2(2.3, 0, 0))]
    result = optimise(graph_of(poses, edges), None)
    np.testing.assert_allclose(result.graph.T_world_scan[:, 0, 3], [0, 1.1, 2.2], atol=1e-9)
    assert result.cost_before == pytest.approx(0.09)
    assert result.cost == pytest.approx(3 * 0.1**2)
    assert result.converged
    sure = np.eye(6) * np.array([1.0, 1.0, 4.0])[:, None, None]
    result = optimise(graph_of(poses, edges, information=sure), None)
    give = 0.3 / 9
    places = [0, 1 + 4 * give, 2 + 8 * give]
    np.testing.assert_allclose(result.graph.T_world_scan[:, 0, 3], places, atol=1e-9)


@pytest.mark.parametrize("planar", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_optimum_is_that_of_a_dense_reference(planar, seed) -> None:
    graph = random_graph(seed, planar)
    axes = graph.axes
    roots = np.swapaxes(np.linalg.cholesky(graph.weights()), 1, 2)

    def residuals(x: Array) -> Array:
        d = np.zeros((len(graph.scans), 6))
        d[1:, axes] = x.reshape(-1, len(axes))
        e = graph.at(moved(graph.T_world_scan, d)).residuals()
        return (roots @ e[:, :, None]).ravel()

    start = np.zeros((len(graph.scans) - 1) * len(axes))
    reference = least_squares(residuals, start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    result = optimise(graph, None, tolerance=1e-12)
    assert result.cost == pytest.approx(2 * reference.cost, rel=1e-8)
    d = np.zeros((len(graph.scans), 6))
    d[1:, axes] = reference.x.reshape(-1, len(axes))
    apart = inverse(moved(graph.T_world_scan, d)) @ result.graph.T_world_scan
    assert np.abs(small(apart)).max() < 1e-5
    if planar:
        assert np.all(result.graph.T_world_scan[:, 2] == [0, 0, 1, 0]), "left the plane"


@pytest.mark.parametrize("phi", [0.5, 1.0, 5.0])
def test_dcs_by_its_definition(phi) -> None:
    """The scale of eq. 15; the cost continuous, its slope the square of the scale."""
    chi2 = np.array([0.0, 0.5 * phi, phi, 2 * phi, 100 * phi])
    scale, cost = dcs(chi2, phi)
    np.testing.assert_allclose(scale, [1, 1, 1, 2 / 3, 2 / 101])
    np.testing.assert_allclose(cost[:3], chi2[:3])
    slope = (dcs(chi2 + 1e-6, phi)[1] - dcs(np.maximum(chi2 - 1e-6, 0), phi)[1])[1:] / 2e-6
    np.testing.assert_allclose(slope[[0, 2, 3]], scale[[1, 3, 4]] ** 2, rtol=1e-4)


def square(wrong: Array | None) -> PoseGraph:
    """Forty steps round a square whose turns are 1 deg too wide, closed by three right loops, and
    one wrong one."""
    step = [se2(1, 0, np.radians(91.0) if i % 10 == 9 else 0.0) for i in range(40)]
    truth, poses = [np.eye(4)], [np.eye(4)]
    for i, T in enumerate(step):
        truth.append(truth[-1] @ se2(1, 0, np.pi / 2 if i % 10 == 9 else 0.0))
        poses.append(poses[-1] @ T)
    edges = [(i, i + 1, T) for i, T in enumerate(step)]
    edges += [(i, 40 - j, inverse(truth[i]) @ truth[40 - j]) for i, j in ((0, 0), (1, 0), (0, 1))]
    loops = [40, 41, 42]
    if wrong is not None:
        edges.append((5, 25, wrong))
        loops.append(43)
    sure = np.tile(np.diag([1e4, 1e4, 1, 1, 1, 2.5e3]), (len(edges), 1, 1))
    return graph_of(poses, edges, information=sure, loops=loops)


def test_dcs_turns_a_wrong_loop_off_and_keeps_right_ones() -> None:
    right, wrong = optimise(square(None)), optimise(square(se2(0.5, 0.2, 1.0)))
    assert np.all(right.scale[40:43] > 0.9) and np.all(wrong.scale[40:43] > 0.9)
    assert wrong.scale[43] < 0.01
    assert np.all(wrong.scale[:40] == 1.0), "edges of the chain are never scaled"
    apart = inverse(right.graph.T_world_scan) @ wrong.graph.T_world_scan
    assert translation_norm(apart).max() < 0.05
    believed = optimise(square(se2(0.5, 0.2, 1.0)), None)
    apart = inverse(right.graph.T_world_scan) @ believed.graph.T_world_scan
    assert translation_norm(apart).max() > 1.0, "without scaling it would bend the square"


def test_the_first_node_is_held_and_two_runs_are_the_same() -> None:
    first, second = (optimise(random_graph(1, False)).graph.T_world_scan for _ in range(2))
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(first[0], np.eye(4))


def test_a_node_without_edges_has_no_place() -> None:
    poses = [np.eye(4)] * 3
    with pytest.raises(ValueError, match="scan 2 is connected to scan 0 by no edge"):
        optimise(graph_of(poses, [(0, 1, np.eye(4))]))


@pytest.mark.parametrize("field", ["T_world_scan", "T_model_scan", "information", "may_be_wrong"])
def test_shapes_are_checked(field) -> None:
    graph = random_graph(0, True)
    values = {name: getattr(graph, name) for name in graph.__dataclass_fields__}
    values[field] = values[field][:-1]
    with pytest.raises(ValueError, match=field):
        PoseGraph(**values)
    with pytest.raises(ValueError, match="none of 7 nodes"):
        PoseGraph(**{**values, field: getattr(graph, field), "ends": graph.ends + 1})
