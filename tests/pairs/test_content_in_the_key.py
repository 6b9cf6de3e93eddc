"""A pair is known by its points, whatever its data set calls itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from loop_helpers import Perfect, drive

from rbtm_bench.backends.base import Prepared
from rbtm_bench.core.types import Scan
from rbtm_bench.pairs.shared import Bounded, KnownRegistrations
from rbtm_bench.pairs.store import PairStore


class Named(Perfect):
    """Names the scans that it prepares, as every real backend does."""

    def prepare(self, scan: Scan) -> Prepared:
        return replace(super().prepare(scan), key=((scan.index, None),))


def test_other_points_under_the_same_name_are_another_pair(tmp_path: Path) -> None:
    """Two data sets with one fingerprint: the second's scan 1 has a point moved by one bit."""
    scans = drive(2)
    moved = scans[1].points.copy()
    moved[3, 0] = np.nextafter(moved[3, 0], 10.0)
    with PairStore(tmp_path) as store:
        for points, reused in ((scans[1].points, False), (scans[1].points, True), (moved, False)):
            known = KnownRegistrations(Named(), store, b"context", Bounded(1e9), Bounded(1e9))
            model, _ = known.prepare(scans[0])
            scan, _ = known.prepare(replace(scans[1], points=points))
            assert known.register(scan, model, np.eye(4)).reused is reused
            store.flush()
