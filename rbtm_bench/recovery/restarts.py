"""Half the motion, none, and a wide search: where a wrong guess is mended."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from annotated_types import Ge, Le
from scipy.spatial.transform import Rotation

from rbtm_bench.backends.base import Prepared
from rbtm_bench.core.geometry import inverse, se3
from rbtm_bench.core.types import Array
from rbtm_bench.recovery.base import Recovery, Restart
from rbtm_bench.search.correlative import CorrelativeSearch


class Restarts(Recovery):
    """Starts from half the guessed motion, from rest, and, in the plane, from the best pose of a
    correlative search of +-``translation`` m and +-``rotation_deg`` around the guess (0: none).

    What fails on a hand-held sensor is mostly the guess: a last motion taken for the next one.
    """

    def __init__(
        self,
        half: bool = True,
        rest: bool = True,
        translation: Annotated[float, Ge(0)] = 1.0,
        rotation_deg: Annotated[float, Ge(0), Le(180)] = 30.0,
    ) -> None:
        self.half, self.rest = half, rest
        self.search = None
        if translation > 0.0:
            self.search = CorrelativeSearch(translation, rotation_deg, sigmas=0.0)

    def restarts(
        self, source: Prepared, target: Prepared, T_guess: Array, T_rest: Array
    ) -> Sequence[Restart]:
        starts = [Restart("half", halfway(T_rest, T_guess))] if self.half else []
        starts += [Restart("rest", T_rest)] if self.rest else []
        if self.search is not None and source.planar and target.planar:
            widest = self.search.start(source, target, T_guess)
            starts.append(Restart("search", widest.T_target_source))
        return starts


def halfway(T: Array, other: Array) -> Array:
    """The motion (4, 4) in the middle between two: half the way, half the turn."""
    step = inverse(T) @ other
    turn = Rotation.from_matrix(step[:3, :3]).as_rotvec()
    return T @ se3(0.5 * step[:3, 3], Rotation.from_rotvec(0.5 * turn).as_matrix())
