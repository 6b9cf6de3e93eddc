"""RBTM with several model scans: the oldest that pass, all of which have a say in the pose."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Gt

from rbtm_bench.core.kinds import Distance, Threshold
from rbtm_bench.selection.base import Content, Fallback
from rbtm_bench.selection.rbtm import Rbtm


class RbtmK(Rbtm):
    """RBTM's candidates in RBTM's order; the first ``edges`` whose registrations are accepted all
    become edges, and the pose is what agrees best with them (``graph.fused``). One edge: RBTM to
    the bit. Settings else as in ``ThresholdSelector``."""

    def __init__(
        self,
        edges: Annotated[int, Ge(1)] = 3,
        window: Annotated[int, Ge(2)] = 10,
        threshold: Threshold = 0.7,
        fallback: Fallback = "previous",
        restart_after: Annotated[int, Ge(1)] | None = None,
        content: Content = "scans",
        keyframe_distance: Distance = 0.3,
        keyframe_angle_deg: Annotated[float, Gt(0)] = 15.0,
    ) -> None:
        super().__init__(
            window,
            threshold,
            fallback,
            restart_after,
            content,
            keyframe_distance,
            keyframe_angle_deg,
        )
        self.edges = edges
        self.covariance_from = "localizability" if edges > 1 else None
