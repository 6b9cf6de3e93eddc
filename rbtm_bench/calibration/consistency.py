"""The stand-in where no truth is known: do registrations of the same scans contradict each other?

Forward and backward: T_AB T_BA should be no motion. Loop: T_AH T_HB T_BA, over a scan H between,
should be none either. The error of a pair is the larger of the two. Every registration starts from
a guess with an error of its own, else a method that hands its guess back would never contradict
itself. What is the same wrong in every direction (a corridor that looks alike everywhere) is not
seen: consistent is necessary, not sufficient.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from rbtm_bench.core.geometry import rotation_angle, translation_norm
from rbtm_bench.core.types import Array, RegistrationResult

Register = Callable[[int, int, Array], RegistrationResult]
"""Registers scan ``source`` to scan ``target``: (target, source, T_target_source)."""


def contradiction(
    target: int, source: int, middle: int, starts: dict[tuple[int, int], Array], register: Register
) -> tuple[RegistrationResult, float, float]:
    """The registration of ``source`` to ``target``, and by how many m and deg it contradicts that
    of the other direction and, with a ``middle`` scan (-1: none), those of the loop over it.

    ``starts`` holds the initial guess of every (target, source) that is needed.
    """
    forward = register(target, source, starts[target, source])
    back = register(source, target, starts[source, target]).T_target_source
    metres, degrees = _size(forward.T_target_source @ back)
    if middle >= 0:
        first = register(target, middle, starts[target, middle]).T_target_source
        second = register(middle, source, starts[middle, source]).T_target_source
        loop = _size(first @ second @ back)
        metres, degrees = max(metres, loop[0]), max(degrees, loop[1])
    return forward, metres, degrees


def _size(T: Array) -> tuple[float, float]:
    return float(translation_norm(T)), math.degrees(float(rotation_angle(T)))
