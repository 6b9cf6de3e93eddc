"""What kind of setting a setting is: declared where it is declared, asked by ``runs.identity``.

A plug-in's parameter is always WHAT (a data set's: DATA), whatever it is called, unless its
annotation says otherwise::

    def __init__(self, seed: Seed = 0, gaps_from: OtherRun = None) -> None: ...

or its config takes the run's own seed over (``seed: ${seed}``).
"""

from __future__ import annotations

from enum import Enum
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le


class Kind(Enum):
    """The kinds. Two runs are the same if they agree in WHAT, DATA and SEED; replicates of one
    method if they differ in SEED alone."""

    WHAT = "what is computed"
    DATA = "on which data"
    SEED = "seed"
    HOW = "how it is executed, or what it leaves"
    FEED = "a value that plug-ins take over, where it counts"
    OTHER_RUN = "the folder of another run"


Seed = Annotated[int, Ge(0), Kind.SEED]
OtherRun = Annotated[str | None, Kind.OTHER_RUN]


class Nuisance(Enum):
    """Settings whose exact value nobody means: replicates of a method move them a little."""

    DISTANCE = "m, times a factor near 1"
    THRESHOLD = "of a score or a share, plus a little"


Distance = Annotated[float, Gt(0), Nuisance.DISTANCE]
Length = Annotated[float, Ge(0), Nuisance.DISTANCE]
VoxelSize = Length
Threshold = Annotated[float, Ge(-1), Le(1), Nuisance.THRESHOLD]
ShareThreshold = Annotated[float, Ge(0), Le(1), Nuisance.THRESHOLD]
OpenThreshold = Threshold | Literal["auto"]
"""A threshold, or "auto": a run takes it from the data's first part."""
