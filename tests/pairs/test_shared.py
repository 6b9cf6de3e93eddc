"""What is kept in memory and handed out again: within its bound, and what was asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from loop_helpers import Perfect, drive, method

from rbtm_bench.backends.base import Backend, Prepared
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.types import Array, Node, Scan
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.odometry import judge
from rbtm_bench.pairs.shared import Bounded, KnownScores, Memory, SharedWork
from rbtm_bench.pairs.store import PairStore
from rbtm_bench.selection.window import Window
from rbtm_bench.similarity.base import Similarity

# --- memory


def test_an_item_larger_than_the_bound_is_kept_alone() -> None:
    """Whoever puts it asks for it next; everything older goes, and it goes with the next one."""
    bounded: Bounded[str] = Bounded(100)
    bounded.put("a", "small", 30)
    assert bounded.put("b", "large", 500) == "large"
    assert bounded.get("b") == "large" and bounded.get("a") is None
    bounded.put("c", "small", 30)
    bounded.put("d", "small", 70)
    assert [bounded.get(key) for key in "bcd"] == [None, "small", "small"]


def test_the_bound_itself_is_not_beyond_it() -> None:
    bounded: Bounded[int] = Bounded(90)
    for item in range(3):
        bounded.put(item, item, 30)
    assert bounded.get(0) == 0  # now 1 is the one not used for longest
    bounded.put(3, 3, 1)
    assert [bounded.get(item) for item in range(4)] == [0, None, 2, 3]


# --- scores


class Apart(Similarity):
    """The score of scans i < j is 1 / (10 i + j): every pair has its own."""

    def describe(self, scan: Scan) -> Array:
        return np.array([float(scan.index)])

    def scores(self, window: Array, descriptor: Array) -> Array:
        return 1.0 / (10.0 * window[:, 0] + descriptor[0])


class Drive(Dataset):
    """Ten scans."""

    def fingerprint(self) -> str:
        return "ten scans"

    def __len__(self) -> int:
        return 10

    def __getitem__(self, index: int) -> Scan:
        return drive(1, first=range(10)[index])[0]


@pytest.mark.parametrize("width", [0, 3, 9])
@pytest.mark.parametrize("models", [[4, 5, 6], [6], [3, 4, 5], [1, 2, 3], [2, 4, 6], [0, 6]])
def test_known_scores_are_those_of_the_window_oldest_first(width: int, models: list[int]) -> None:
    """Of scan 7; from the band where it reaches, and computed where it does not, or with gaps."""
    known = KnownScores(Apart(), Drive())
    known.widen(width)
    window = Window(10)
    for model in models:
        window.push(Node(model, 0.0, np.eye(4), descriptor=np.array([model])))
    scores, seconds = known.scores(window, 7)
    assert scores.tolist() == [1.0 / (10 * model + 7) for model in models]
    assert seconds >= 0.0


# --- registrations


class Named(Perfect):
    """Names the scans that it prepares, as every real backend does."""

    def prepare(self, scan: Scan) -> Prepared:
        return replace(super().prepare(scan), key=((scan.index, None),))


def shared(
    backend: Backend, store: PairStore | None = None, contexts: Sequence[bytes] = (b"context",)
) -> SharedWork:
    """Work of a new process."""
    memory = Memory(1e9, 1e9, 1e9)
    return SharedWork(method(backend=backend), memory, store, contexts, None, None)


def test_a_registration_is_made_once_and_says_when_it_is_handed_out_again() -> None:
    backend = Perfect()
    work = shared(backend)
    first, second = (work.prepare(scan)[0] for scan in drive(2))
    once, again = (work.register(second, first, np.eye(4)) for _ in range(2))
    assert (once.reused, again.reused) == (False, True)
    assert again.T_target_source is once.T_target_source and again.seconds == once.seconds
    other = work.register(second, first, np.diag([1.0, -1.0, -1.0, 1.0]))
    assert not other.reused and backend.tried == [(0, 1), (0, 1)]
    plain = judge.register(backend, second, first, np.eye(4))
    np.testing.assert_array_equal(plain.T_target_source, once.T_target_source)


def test_other_points_under_the_same_name_are_another_pair(tmp_path: Path) -> None:
    """Two data sets with one fingerprint: the second's scan 1 has a point moved by one bit."""
    scans = drive(2)
    moved = scans[1].points.copy()
    moved[3, 0] = np.nextafter(moved[3, 0], 10.0)
    with PairStore(tmp_path) as store:
        for points, reused in ((scans[1].points, False), (scans[1].points, True), (moved, False)):
            work = shared(Named(), store)
            model, _ = work.prepare(scans[0])
            scan, _ = work.prepare(replace(scans[1], points=points))
            assert work.register(scan, model, np.eye(4)).reused is reused


def test_what_is_computed_beside_strangers_is_for_them_alone(tmp_path: Path) -> None:
    """They read what is known under either context, and write under their own."""
    scans = drive(3)
    ours, theirs = [b"ours"], [b"ours", b"theirs"]
    with PairStore(tmp_path) as store:
        for contexts, pair, reused in (
            (ours, (0, 1), False),
            (theirs, (0, 1), True),
            (theirs, (0, 2), False),
            (theirs, (0, 2), True),
            (ours, (0, 2), False),
        ):
            work = shared(Named(), store, contexts)
            model, scan = (work.prepare(scans[i])[0] for i in pair)
            assert work.register(scan, model, np.eye(4)).reused is reused


def test_a_failure_is_known_as_well(tmp_path: Path) -> None:
    backend = Named(fails=[(0, 1)])
    with PairStore(tmp_path) as store:
        for _ in range(2):
            work = shared(backend, store)
            first, second = (work.prepare(scan)[0] for scan in drive(2))
            for _ in range(2):
                with pytest.raises(BackendError, match="the library raised"):
                    work.register(second, first, np.eye(4))
    assert len(backend.tried) == 1
