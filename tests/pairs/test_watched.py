"""What foreign plug-ins are handed: watched copies, and pairs that can be dropped."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rbtm_bench.core.errors import BackendError
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.pairs.shared import SharedDataset
from rbtm_bench.pairs.store import PairStore
from rbtm_bench.pairs.watched import OVERHEAD, Watch


def test_ours_get_arrays_that_cannot_be_written_into() -> None:
    scan = SharedDataset(Corridor(scans=3, beams=19), 1e6)[1]
    assert set(scan.arrays()) == {"points", "ranges", "angles", "odometry", "ground_truth"}
    for array in scan.arrays().values():
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


def test_theirs_get_copies_that_are_watched() -> None:
    plain, watch = Corridor(scans=3, beams=19), Watch(1e6)
    dataset = SharedDataset(plain, 1e6, watch)
    dataset[0].points.setflags(write=False)
    first, again = dataset[1], dataset[1]
    assert not np.shares_memory(first.ranges, again.ranges) and watch.changed() == []
    dataset[2].odometry[0, 3] += 1e-12
    dataset[2].ranges[:2] = np.nan
    assert watch.changed() == ["scan 2's odometry", "scan 2's ranges"]
    assert np.array_equal(dataset[2].ranges, plain[2].ranges, equal_nan=True)
    watch.begin()
    assert watch.changed() == []


def test_beyond_the_bound_the_oldest_is_looked_at_and_let_go() -> None:
    watch = Watch(2.5 * (OVERHEAD + 24))
    arrays = [np.zeros(3) for _ in range(4)]
    for number, array in enumerate(arrays):
        watch.hand(f"array {number}", array)
        array[0] = number == 1  # the first is not changed, the second is
    arrays[0][0] = 5.0  # too late
    assert watch.changed() == ["array 1"]


def test_pairs_of_a_held_store_can_be_dropped(tmp_path: Path) -> None:
    with PairStore(tmp_path, batch=1, seconds=0.0) as store, PairStore(tmp_path) as other:
        store.hold(True)
        store.put(b"k" * 24, BackendError("a"))
        assert isinstance(store.get(b"k" * 24), BackendError) and other.get(b"k" * 24) is None
        store.drop()
        store.flush()
        assert store.get(b"k" * 24) is None
        store.put(b"l" * 24, BackendError("b"))
        store.flush()
        assert str(other.get(b"l" * 24)) == "b"
