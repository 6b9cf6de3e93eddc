"""Scans read ahead, and what is completed afterwards: the size of a block changes no bit."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import pytest
from loop_helpers import Perfect, drive, method
from step_helpers import assert_same

from rbtm_bench.core.types import Scan, Step
from rbtm_bench.odometry import loop
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.runs.assembly import Parts, instantiate
from rbtm_bench.runs.settings import compose_settings

WAYS = {
    "the easy path": ["backend=open3d_p2p", "selector=previous"],
    "scores": ["backend=plicp", "selector=rbtm", "selector.window=12"],
    "a check, and scans left out": [
        *("backend=plicp", "selector=rbtm", "selector.window=5", "selector.fallback=skip"),
        *("check=gated", "check.min_fitness=0.97", "selector.restart_after=3"),
    ],
    "keyframes": ["backend=plicp", "selector=rbtm", "selector.content=keyframes"],
    "the guess kept": ["backend=plicp", "selector=rbtm", "guess_along_degenerate=0.05"],
    "the chain's covariance": ["backend=open3d_p2p", "selector=least_uncertain"],
    "all tried": ["backend=open3d_p2p", "selector=oracle", "selector.window=4"],
    "the trajectory in the guess": ["backend=plicp", "selector=keyframe", "guess=chain"],
    "scores under a guess": ["backend=open3d_p2p", "selector=rbtm", "similarity=overlap"],
    "centred scores": ["backend=none", "selector=rbtm", "similarity.center=true"],
    "scores over lags": ["backend=none", "selector=rbtm", "similarity.max_lag_deg=4"],
}


def parts_of(way: str) -> Parts:
    words = ["dataset=corridor", "dataset.environment=l_turn", "dataset.scans=60", *WAYS[way]]
    return instantiate(compose_settings(words))


def run(way: str, block: int) -> list[Step]:
    parts = parts_of(way)
    return list(odometry(parts.dataset, parts.method, None, block))


@pytest.mark.parametrize("way", WAYS)
def test_blocks_of_1_7_and_256_scans_give_the_same_bits(way: str) -> None:
    one = run(way, 1)
    assert len(one) == 60
    for block in (7, 256):
        assert_same(one, run(way, block))


def endless() -> Iterator[Scan]:
    return (scan for i in itertools.count() for scan in drive(1, i))


@pytest.mark.parametrize(("block", "read"), [(1, 1), (3, 3)])
def test_a_live_stream_is_answered_scan_by_scan(block: int, read: int) -> None:
    """The first answer needs no scan beyond the block."""
    taken: list[int] = []

    def stream() -> Iterator[Scan]:
        for scan in endless():
            taken.append(scan.index)
            yield scan

    next(odometry(stream(), method(), block=block))
    assert taken == list(range(read))


def test_a_block_ends_where_its_points_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop, "MOST_POINTS", 25)  # scans of 10 points
    assert [len(part) for part in loop._blocks(drive(7), 256)] == [3, 3, 1]
    assert [len(part) for part in loop._blocks(drive(7), 2)] == [2, 2, 2, 1]


def test_fewer_than_three_inliers_are_refused_whatever_the_check() -> None:
    """Of scan 2 all but two points lie elsewhere."""
    scans = drive(4)
    moved = scans[2].points + np.where(np.arange(10) < 2, 0.0, 50.0)[:, None]
    scans[2] = Scan(2, scans[2].stamp, moved, odometry=scans[2].odometry)
    from rbtm_bench.check.none import AcceptAll

    steps = list(odometry(scans, method(Perfect(), check=AcceptAll())))
    assert [step.record.status for step in steps] == [
        "first",
        "registered",
        "predicted",
        "predicted",
    ]
    assert steps[2].record.reason == "2 inliers: expected at least 3"
