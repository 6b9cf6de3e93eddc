"""RBTM's own reason taken at its word: the candidate with the shortest chain to the start."""

from __future__ import annotations

from collections.abc import Sequence

from rbtm_bench.core.types import Array, Node
from rbtm_bench.selection.thresholded import ChainSelector


class FewestHops(ChainSelector):
    """Of the members whose similarity exceeds ``threshold`` the one with the fewest edges between
    itself and the start; of equals the most similar, of these the older.

    A chain's errors add up edge by edge, which is why the paper takes the oldest scan: on a path
    that never returns that is the one with the fewest hops. On one that does, a newer scan can
    have a shorter chain. Among equals the chain says nothing, so what is left is how well the
    last edge will do. A predicted edge is a hop, too. Settings as in ``ThresholdSelector``.
    """

    def order_nodes(self, nodes: Sequence[Node], scores: Array) -> list[tuple[int, str]]:
        ranked = sorted(self.passing(scores), key=lambda i: (nodes[i].hops, -scores[i], i))
        return [(i, f"{nodes[i].hops} hops, {self.passed}") for i in ranked]
