"""What closes loops: after the last scan, from the run's edges and its scans."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

from rbtm_bench.core.types import Array, Edge, Step
from rbtm_bench.core.uncertainty import InformationFrom
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.odometry.method import Work

if TYPE_CHECKING:  # it brings scipy
    from rbtm_bench.graph.pose_graph import PoseGraph


@dataclass(eq=False)
class Route:
    """What a run hands over: the scans' numbers, their poses (4, 4) and all edges, step by step."""

    scans: list[int] = field(default_factory=list)
    T_world_scan: list[Array] = field(default_factory=list)
    edges: list[Edge] = field(default_factory=list)

    def add(self, step: Step) -> None:
        """The next step."""
        self.scans.append(step.record.scan)
        self.T_world_scan.append(step.T_world_scan)
        self.edges += step.edges


@dataclass(frozen=True, eq=False)
class Closing:
    """What became of a run's loops: the poses of all steps (N, 4, 4) with them, the graph at these
    poses, and counts: pairs that were registered, those believed and those refused, and those
    believed that the optimiser turned off (they count less than half). ``seconds`` is all of it,
    registrations known from before by what they took.
    """

    T_world_scan: Array
    graph: PoseGraph
    candidates: int
    accepted: int
    rejected: int
    turned_off: int
    seconds: float


class Loops(ABC):
    """Finds places met again and corrects the poses of all scans; a plug-in writes ``close``."""

    requires: tuple[str, ...] = ()
    needs_scores: ClassVar[bool] = False
    """Whether the similarity is asked for anything."""
    is_off: ClassVar[bool] = False
    """True for what closes none: a run is then what it was before there were loops."""
    covariance_from: InformationFrom | None = None
    """Where the covariance of the run's edges comes from; None: they need none."""

    @abstractmethod
    def close(self, route: Route, dataset: Dataset, work: Work) -> Closing | None:
        """Close the loops of a finished run. ``dataset[i]`` is scan number i, without ground truth;
        ``work`` registers pairs as the run did. None: nothing was asked."""
