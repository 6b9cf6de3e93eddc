"""Poses that follow from edges."""

from __future__ import annotations

import numpy as np

from rbtm_bench.core.errors import RunError
from rbtm_bench.core.geometry import is_rigid
from rbtm_bench.core.rigid import rigidity
from rbtm_bench.core.trajectory import orthonormalised
from rbtm_bench.core.types import Array, Edge

EDGE_TOLERANCE = 1e-4
"""How far from orthonormal the rotation of an edge may be: one in single precision passes."""

ROUNDING = 1e-14
"""A pose further from rigid than this is pulled back."""


class PoseChain:
    """Poses of scans, each chained to the pose of its model scan (T_1j = T_1m T_mj).

    Rounding errors do not pile up: every new rotation is orthonormalised, so the pose after any
    number of edges is as rigid as the first. The poses handed out are read-only.
    """

    def __init__(self) -> None:
        self._poses: dict[int, Array] = {}

    def __len__(self) -> int:
        return len(self._poses)

    def __contains__(self, scan_index: object) -> bool:
        return scan_index in self._poses

    def start(self, scan_index: int, T_world_scan: Array | None = None) -> Array:
        """Set the pose (4, 4) of the first scan, the identity by default, and return it.

        Raises ``RunError`` if the chain has started or the pose is not rigid.
        """
        if self._poses:
            raise RunError(f"scan {scan_index} cannot start a chain that has already started")
        T = np.eye(4) if T_world_scan is None else np.array(T_world_scan, dtype=float)
        if not is_rigid(T):
            raise RunError(f"the first pose, of scan {scan_index}, is not a rigid motion")
        return self._set(scan_index, T)

    def add(self, edge: Edge) -> Array:
        """Give ``edge.scan`` the pose T_world_model @ T_model_scan (4, 4) and return it.

        Raises ``RunError`` if the model scan has no pose, the scan has one already (others may
        follow from it), or the motion is not rigid.
        """
        known = self._poses.get(edge.model)
        if known is None:
            raise RunError(f"{_name(edge)}: scan {edge.model} has no pose")
        if edge.scan in self._poses:
            raise RunError(f"{_name(edge)}: scan {edge.scan} already has a pose")
        motion = edge.T_model_scan
        if motion.shape != (4, 4) or not rigidity(motion) <= EDGE_TOLERANCE:
            raise RunError(f"{_name(edge)}: its motion is not rigid")
        return self._set(edge.scan, known @ edge.T_model_scan)

    def pose(self, scan_index: int) -> Array:
        """T_world_scan (4, 4) of a scan; ``RunError`` if it has none."""
        if scan_index not in self._poses:
            raise RunError(f"scan {scan_index} has no pose")
        return self._poses[scan_index]

    def _set(self, scan_index: int, T: Array) -> Array:
        if rigidity(T) > ROUNDING:  # most are rigid to the last bits
            T = orthonormalised(T)
        T.flags.writeable = False
        self._poses[scan_index] = T
        return T


def _name(edge: Edge) -> str:
    return f"edge from model scan {edge.model} to scan {edge.scan}"
