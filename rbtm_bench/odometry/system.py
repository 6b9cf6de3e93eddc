"""The loop for a system, which keeps its own map and model: place, record. Beside ``odometry``."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from rbtm_bench.backends.base import MAX_MOTION
from rbtm_bench.backends.system import System, Tracked, Tracker
from rbtm_bench.core.errors import BackendError, RunError
from rbtm_bench.core.geometry import inverse, translation_norm
from rbtm_bench.core.types import Edge, Scan, Step, StepRecord
from rbtm_bench.odometry.chain import PoseChain


def system_odometry(scans: Iterable[Scan], system: System) -> Iterator[Step]:
    """Feed a stream of scans to a fresh tracker and yield what became of each.

    The first scan is the origin; an edge is the motion since the previous scan. A scan that the
    system places is "registered", to no single model scan, so without model, gap and fitness. One
    that it cannot place ("unusable"), or places by prediction alone ("predicted"), gets the last
    motion again or the system's prediction.
    """
    tracker = system.start()
    chain = PoseChain()
    motion = T_before = np.eye(4)  # T_before: of the previous scan, in the tracker's world
    previous: int | None = None
    is_tracking = False
    for scan in scans:
        record = StepRecord(scan.index, scan.stamp)
        tracked = _track(scan.without_truth(), tracker, record)
        if previous is None:
            edges: tuple[Edge, ...] = ()
            T_world_scan = chain.start(scan.index)
            T_now = np.eye(4) if tracked is None else tracked.T_world_scan
        else:
            if tracked is not None:
                _record(record, tracked, is_tracking)
            # the tracker's world begins at its first scan: until then nothing is known to move
            T_now = T_before @ motion if tracked is None else tracked.T_world_scan
            T_before = T_before if is_tracking else T_now
            motion = inverse(T_before) @ T_now
            if translation_norm(motion) > MAX_MOTION:
                name = type(system).__name__
                raise RunError(f"{name}: an implausible motion between two scans: {motion[:3, 3]}")
            kind = "system" if record.status == "registered" else "predicted"
            edges = (Edge(previous, scan.index, motion, kind=kind),)
            T_world_scan = chain.add(edges[0])
        is_tracking = is_tracking or tracked is not None
        previous, T_before = scan.index, T_now
        yield Step(record, edges, T_world_scan)


def _track(scan: Scan, tracker: Tracker, record: StepRecord) -> Tracked | None:
    """The scan's place, or None (and why) if the system cannot use it."""
    try:
        tracked = tracker.track(scan)
    except BackendError as error:
        record.status, record.reason = "unusable", str(error)
        return None
    record.t_register_s = tracked.seconds
    return tracked


def _record(record: StepRecord, tracked: Tracked, is_tracking: bool) -> None:
    record.registrations = 1
    record.converged = tracked.converged
    if not is_tracking:
        record.status, record.reason = "predicted", "no scan before it"
    elif tracked.converged is False:
        record.status, record.reason = "predicted", "nothing of the scan meets the system's map"
    else:
        record.status, record.reason = "registered", "system"
