"""The settings outside every plug-in, declared once (name, type, kind), and the groups."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NamedTuple

from annotated_types import Ge, Gt, Le, Lt
from typing_extensions import TypedDict

from rbtm_bench.core.kinds import Kind, Seed

PLUGIN_GROUPS = (
    "dataset",
    "backend",
    "similarity",
    "selector",
    "guess",
    "search",
    "check",
    "recovery",
    "target",
    "loops",
)
GROUPS = (*PLUGIN_GROUPS, "metrics")
ADDED = {"search": "none", "recovery": "none", "loops": "none"}
"""Groups that older runs do not name, with the member that does what was done before."""
FOR_PAIRS = (
    "similarity",
    "selector",
    "guess",
    "search",
    "check",
    "recovery",
    "target",
    "loops",
    "guess_along_degenerate",
    "guess_weight",
    "motion_filter",
    "judge_points",
    "judge_radius",
)
"""The groups and settings that a backend which is a whole system does without."""


class Pairs(TypedDict):
    """The settings of ``pairs``."""

    store: Literal["off", "shared", "per_worker"]
    folder: str | None
    memory_mb: Annotated[float, Gt(0)]


class MotionFilterSettings(TypedDict):
    """The settings of ``motion_filter``."""

    distance: Annotated[float, Ge(0)]
    angle_deg: Annotated[float, Ge(0)]


class Perturbation(TypedDict):
    """The settings of ``perturbation``: how far replicates are from the data and the settings as
    they are (``datasets.perturbed``, ``runs.replicate``)."""

    ranges: Annotated[float, Ge(0), Le(1 / 3)]
    odometry: Annotated[float, Ge(0), Le(0.1)]
    start_scans: Annotated[int, Ge(0)]
    distances: Annotated[float, Ge(0), Le(0.1)]
    thresholds: Annotated[float, Ge(0), Le(0.01)]


PERTURBATION = Perturbation(
    ranges=0.33, odometry=0.1, start_scans=10, distances=0.1, thresholds=0.01
)
"""What is perturbed unless told otherwise, and in runs that do not say."""


class Perturb(TypedDict):
    """The settings of ``perturb``: what is done to the data (``datasets.degraded``)."""

    dropout: Annotated[float, Ge(0), Lt(1)]
    outliers: Annotated[float, Ge(0), Le(1)]
    blocked: Annotated[float, Ge(0), Lt(1)]
    movers: Annotated[int, Ge(0), Le(1000)]
    first_scan: Annotated[int, Ge(0)]
    end_scan: Annotated[int, Ge(1)] | None
    every_scan: Annotated[int, Ge(1)]
    every_beam: Annotated[int, Ge(1)]
    odometry_scale: Annotated[float, Ge(-1)]
    odometry_drift_deg: float


# A word with a slip in it would do nothing, unseen.
Perturb.__pydantic_config__ = {"extra": "forbid"}  # type: ignore[attr-defined]

PERTURB = Perturb(
    dropout=0.0,
    outliers=0.0,
    blocked=0.0,
    movers=0,
    first_scan=0,
    end_scan=None,
    every_scan=1,
    every_beam=1,
    odometry_scale=0.0,
    odometry_drift_deg=0.0,
)
"""The data as they are."""


class Shared(NamedTuple):
    """A setting outside every group: its type (None: the plug-ins check it) and its kind."""

    type: Any
    kind: Kind


SHARED = {
    "seed": Shared(Seed, Kind.SEED),
    "replicates": Shared(Annotated[int, Ge(1)], Kind.HOW),
    "controls": Shared(Literal["auto", "none"], Kind.HOW),
    "replicate": Shared(Annotated[int, Ge(0)], Kind.SEED),
    "perturbation": Shared(Perturbation, Kind.WHAT),
    "perturb": Shared(Perturb, Kind.DATA),
    "deskew": Shared(bool, Kind.DATA),
    "out": Shared(str | None, Kind.HOW),
    "overwrite": Shared(bool, Kind.HOW),
    "pictures": Shared(bool, Kind.HOW),
    "pairs": Shared(Pairs, Kind.HOW),
    "pin": Shared(bool, Kind.HOW),
    "time_limit": Shared(Annotated[float, Gt(0)] | None, Kind.HOW),
    "memory_limit": Shared(Annotated[float, Gt(0)] | None, Kind.HOW),
    "map_resolution": Shared(Annotated[float, Gt(0)], Kind.HOW),
    "guess_weight": Shared(Annotated[float, Gt(0)] | None, Kind.WHAT),
    "motion_filter": Shared(MotionFilterSettings, Kind.WHAT),
    "guess_along_degenerate": Shared(Annotated[float, Gt(0), Lt(1)] | None, Kind.WHAT),
    "judge_points": Shared(Annotated[int, Ge(100)], Kind.WHAT),
    "judge_radius": Shared(Annotated[float, Gt(0)] | None, Kind.WHAT),
    "registration": Shared(None, Kind.FEED),
    "selection": Shared(None, Kind.FEED),
    "descriptor": Shared(None, Kind.FEED),
}
"""Every setting outside the groups. Whatever else stands in a config is WHAT."""


def kind_of(key: str) -> Kind:
    """The kind of a dotted key, as far as its first word tells it (``identity.special`` knows the
    plug-ins' own seeds and folders)."""
    first = key.partition(".")[0]
    if first in SHARED:
        return SHARED[first].kind
    return Kind.DATA if first == "dataset" else Kind.WHAT
