"""The chain of consecutive registrations, each begun from wheel odometry."""

from __future__ import annotations

from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.guess.base import odometry_of
from rbtm_bench.guess.chain import Chain


class OdometryChain(Chain):
    """T_model_scan = inv(C_model) C_scan as in ``Chain``, but every registration to the scan before
    begins from the wheel motion between the two, and a scan that cannot be registered keeps it.

    As accurate as ``odometry_chained`` on most logs and, unlike it, pure: the runs of a sweep share
    the chain and all registrations that begin from it.
    """

    needs_odometry = True

    def _step(self, scan: Scan) -> Array:
        assert self._odometry is not None
        return inverse(self._odometry) @ odometry_of(scan)
