"""Wheel odometry between the model scan and the new one."""

from __future__ import annotations

from collections.abc import Sequence

from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array, Node, Scan
from rbtm_bench.guess.base import Guess, from_previous, odometry_of


class Odometry(Guess):
    """T_model_scan = inv(O_model) O_scan: a pure function of the pair."""

    pure = True
    needs_odometry = True

    def predict(self, model: Node, scan: Scan, recent: Sequence[Node]) -> Array:
        return inverse(odometry_of(model)) @ odometry_of(scan)


class OdometryChained(Guess):
    """T_model_scan = inv(T_model) T_previous inv(O_previous) O_scan: the estimated trajectory up
    to the previous scan, and odometry only for the last step."""

    needs_odometry = True

    def predict(self, model: Node, scan: Scan, recent: Sequence[Node]) -> Array:
        step = inverse(odometry_of(recent[-1])) @ odometry_of(scan)
        return from_previous(model, recent, step)
