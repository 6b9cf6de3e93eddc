"""The poses that agree best with all edges of a pose graph: sparse, damped Gauss-Newton."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix, diags
from scipy.sparse.linalg import splu

from rbtm_bench.core.trajectory import orthonormalised
from rbtm_bench.core.types import Array
from rbtm_bench.graph.motions import moved
from rbtm_bench.graph.pose_graph import PoseGraph
from rbtm_bench.graph.robust import dcs

FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-6, 1e-9, 1e9
"""Of the diagonal of the normal equations (Marquardt 1963): at first, and the limits."""
DESCENT = 5.0
"""What ``phi`` comes down by at a time."""
COARSE = 1e-2
"""Share of the cost that a step may lower it by when ``phi`` comes down again."""


class Optimised(NamedTuple):
    """The graph at its best poses; how much each edge counts (E,), 1 or, of one that may be wrong,
    less; the sum of costs before and after; the steps taken; whether the last changed next to
    nothing."""

    graph: PoseGraph
    scale: Array
    cost_before: float
    cost: float
    iterations: int
    converged: bool


def optimise(
    graph: PoseGraph, phi: float | None = 1.0, iterations: int = 100, tolerance: float = 1e-6
) -> Optimised:
    """Minimise the sum of e^T information e over the edges, the first node held.

    Edges that may be wrong are scaled (dynamic covariance scaling, ``dcs``) by ``phi``; None: they
    count as all others. Far from the optimum a right loop is as far off as a wrong one and would
    be turned off at once: so they are believed at first, and ``phi`` comes down by steps
    (graduated non-convexity). Each ends when the cost is lowered by less than a share of
    ``tolerance`` (of ``COARSE`` before the last).

    Raises
    ------
    ValueError
        If a node is connected to the first by no edge: it has no place.

    Source
    ------
    Grisetti, Kuemmerle, Stachniss, Burgard, "A tutorial on graph-based SLAM", IEEE ITS Magazine
    2010; damping: Marquardt 1963; the descent of ``phi``: Yang, Antonante, Tzoumas, Carlone,
    "Graduated non-convexity for robust spatial perception", IEEE RA-L 2020.
    """
    _require_connected(graph)
    before = _cost(graph, phi)[0]
    levels: list[float | None] = [phi]
    if phi is not None and graph.may_be_wrong.any():
        level = float(_chi2(graph)[graph.may_be_wrong].max()) / DESCENT
        while level > phi:
            levels.insert(-1, level)
            level /= DESCENT
        levels = [None, *levels] if len(levels) > 1 else levels
    steps, converged = 0, False
    for each in levels:
        enough = tolerance if each == phi else COARSE
        graph, taken, converged = _descend(graph, each, iterations - steps, enough)
        steps += taken
    cost, scale = _cost(graph, phi)
    return Optimised(graph, scale, before, cost, steps, converged)


def _descend(
    graph: PoseGraph, phi: float | None, iterations: int, tolerance: float
) -> tuple[PoseGraph, int, bool]:
    """The graph at the minimum for one ``phi``, the steps taken, and whether it was reached."""
    damping, steps, converged = FIRST_DAMPING, 0, False
    cost, scale = _cost(graph, phi)
    while steps < iterations and not converged and damping <= MOST_DAMPING:
        H, g = normal_equations(graph, scale)
        while damping <= MOST_DAMPING:
            trial = graph.at(_stepped(graph, H, g, damping))
            new_cost, new_scale = _cost(trial, phi)
            if new_cost <= cost:
                converged = cost - new_cost <= tolerance * cost
                graph, cost, scale = trial, new_cost, new_scale
                damping = max(0.1 * damping, LEAST_DAMPING)
                steps += 1
                break
            damping *= 10.0
    return graph, steps, converged


def _cost(graph: PoseGraph, phi: float | None) -> tuple[float, Array]:
    """The sum of costs, and every edge's scale (E,)."""
    cost, scale = _chi2(graph), np.ones(len(graph.ends))
    if phi is not None:
        loops = graph.may_be_wrong
        scale[loops], cost[loops] = dcs(cost[loops], phi)
    return float(cost.sum()), scale


def _chi2(graph: PoseGraph) -> Array:
    """e^T information e of every edge (E,)."""
    e = graph.residuals()
    return ((graph.weights() @ e[:, :, None])[:, :, 0] * e).sum(axis=1)


def normal_equations(graph: PoseGraph, scale: Array) -> tuple[csc_matrix, Array]:
    """H and g of H d = -g at the graph's poses, each edge with its ``scale`` (E,), the first node
    held: left out."""
    e, by_model, by_scan = graph.linearised()
    weights = graph.weights() * (scale**2)[:, None, None]
    size, count = len(graph.axes), len(graph.scans)
    ends, sides = graph.ends, (by_model, by_scan)
    g = np.zeros((count, size))
    rows, columns, blocks = [], [], []
    within = np.arange(size)
    for a, by_a in enumerate(sides):
        weighted = np.swapaxes(by_a, 1, 2) @ weights
        np.add.at(g, ends[:, a], (weighted @ e[:, :, None])[:, :, 0])
        for b, by_b in enumerate(sides):
            block = weighted @ by_b
            rows.append(np.broadcast_to(_places(ends[:, a], within)[:, :, None], block.shape))
            columns.append(np.broadcast_to(_places(ends[:, b], within)[:, None, :], block.shape))
            blocks.append(block)
    flat = [np.concatenate([part.ravel() for part in parts]) for parts in (blocks, rows, columns)]
    H = csc_matrix((flat[0], (flat[1], flat[2])), shape=(count * size, count * size))
    return H[size:, size:], g.ravel()[size:]


def _places(nodes: NDArray[np.int64], within: NDArray[np.int64]) -> NDArray[np.int64]:
    """Where a node's components are among all unknowns (E, D)."""
    return nodes[:, None] * len(within) + within


def _stepped(graph: PoseGraph, H: csc_matrix, g: Array, damping: float) -> Array:
    """The poses after one damped step."""
    damped = (H + diags(damping * H.diagonal())).tocsc()
    solver = splu(damped, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    d = np.zeros((len(graph.scans), 6))
    d[1:, graph.axes] = solver.solve(-g).reshape(len(d) - 1, -1)
    return orthonormalised(moved(graph.T_world_scan, d))


def _require_connected(graph: PoseGraph) -> None:
    from scipy.sparse.csgraph import connected_components

    count = len(graph.scans)
    model, scan = graph.ends.T
    links = csc_matrix((np.ones(len(model)), (model, scan)), shape=(count, count))
    number, label = connected_components(links, directed=False)
    if number > 1:
        lost = graph.scans[np.flatnonzero(label != label[0])[0]]
        raise ValueError(f"scan {lost} is connected to scan {graph.scans[0]} by no edge")
