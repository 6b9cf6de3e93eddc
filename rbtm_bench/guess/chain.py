"""The chain of consecutive registrations: a good guess without odometry."""

from __future__ import annotations

from collections.abc import Sequence

from rbtm_bench.backends.base import Prepared
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.trajectory import orthonormalised
from rbtm_bench.core.types import Array, Node, Scan
from rbtm_bench.guess.base import IDENTITY, Guess, Register


class Chain(Guess):
    """T_model_scan = inv(C_model) C_scan, where C is the trajectory that the run's own backend
    gives when every scan is registered to the one before, with the last motion as its guess.

    C does not depend on which model scans a run chooses, so the guess is a pure function of the
    pair and the backend: the runs of a sweep share their registrations. It costs one more
    registration a scan, which a sweep computes once. A scan that cannot be registered keeps the
    last motion.
    """

    pure = True
    needs_backend = True

    def __init__(self) -> None:
        self._poses: dict[int, Array] = {}
        self._seconds: dict[int, float] = {}
        self._last: tuple[int, Prepared] | None = None
        self._motion = IDENTITY
        self._newest = -1
        self._odometry: Array | None = None

    def observe(self, scan: Scan, prepared: Prepared | None, register: Register) -> float:
        """Extend the chain by a scan; returns the seconds that it took (when it was new)."""
        if scan.index in self._poses:
            return self._seconds[scan.index]
        seconds = 0.0
        before = self._poses.get(self._newest)
        pose = IDENTITY if before is None else before @ self._step(scan)
        if prepared is not None and self._last is not None:
            model, target = self._last
            guess = inverse(self._poses[model]) @ pose
            try:
                result = register(prepared, target, guess)
                seconds = result.seconds
                pose = orthonormalised(self._poses[model] @ result.T_target_source)
            except BackendError:
                pass
        if before is not None:
            self._motion = inverse(before) @ pose
        self._poses[scan.index], self._seconds[scan.index] = pose, seconds
        self._newest, self._odometry = scan.index, scan.odometry
        if prepared is not None:
            self._last = (scan.index, prepared)
        return seconds

    def _step(self, scan: Scan) -> Array:
        """Where the scan's registration begins: T_before_scan (4, 4)."""
        return self._motion

    def predict(self, model: Node, scan: Scan, recent: Sequence[Node]) -> Array:
        return inverse(self._poses[model.scan]) @ self._poses[scan.index]
