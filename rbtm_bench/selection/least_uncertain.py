"""The candidate whose position is the least uncertain, by the covariance along its chain."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from annotated_types import Ge, Gt

from rbtm_bench.core.kinds import Distance, OpenThreshold
from rbtm_bench.core.types import Array, Node
from rbtm_bench.core.uncertainty import InformationFrom, position_std
from rbtm_bench.selection.base import Content, Fallback
from rbtm_bench.selection.thresholded import ChainSelector


class LeastUncertain(ChainSelector):
    """Of the members whose similarity exceeds ``threshold`` the one with the smallest trace of its
    position's covariance, accumulated over the edges between itself and the start; of equals the
    older.

    ``information`` says where an edge's covariance comes from: "own" is the registration method's
    own information where it gives one, "localizability" ours, the same for every backend (see
    ``uncertainty.edge_covariance``). Settings else as in ``ThresholdSelector``.
    """

    def __init__(
        self,
        window: Annotated[int, Ge(2)] = 10,
        threshold: OpenThreshold = 0.7,
        fallback: Fallback = "previous",
        restart_after: Annotated[int, Ge(1)] | None = None,
        content: Content = "scans",
        keyframe_distance: Distance | None = 0.3,
        keyframe_angle_deg: Annotated[float, Gt(0)] = 15.0,
        keyframe_distance_relative: Annotated[float, Gt(0)] | None = None,
        window_m: Distance | None = None,
        information: InformationFrom = "own",
    ) -> None:
        super().__init__(
            window,
            threshold,
            fallback,
            restart_after,
            content,
            keyframe_distance,
            keyframe_angle_deg,
            keyframe_distance_relative,
            window_m,
        )
        self.covariance_from = information

    def order_nodes(self, nodes: Sequence[Node], scores: Array) -> list[tuple[int, str]]:
        unsure = {i: _position_std(nodes[i]) for i in self.passing(scores)}
        ranked = sorted(unsure, key=lambda i: (unsure[i], i))
        return [(i, f"{unsure[i]:.3g} m unsure, {self.passed}") for i in ranked]


def _position_std(node: Node) -> float:
    assert node.covariance is not None  # the loop has it for whoever says covariance_from
    return position_std(node.covariance)
