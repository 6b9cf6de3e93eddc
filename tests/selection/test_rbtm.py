"""The paper's section II.B and Fig. 2, and what it leaves open."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rbtm_bench.core.geometry import se2
from rbtm_bench.core.types import Node
from rbtm_bench.selection.rbtm import Rbtm

NAN = float("nan")


def tried(
    scores: list[float], scan: int = 4, models: list[int] | None = None, **settings: Any
) -> list[tuple[int, bool]]:
    """(model scan, is it the fallback) in the order in which they are to be tried."""
    models = list(range(scan - len(scores), scan)) if models is None else models
    selector = Rbtm(window=len(scores) + 1, **settings)
    selection = selector.select(scan, np.array(models), np.array(scores))
    return [(c.model, c.is_fallback) for c in selection.candidates]


def test_figure_2() -> None:
    """w = 4, step 4: S_14 is too low, S_24 passes, so the pose of 4 comes from 2."""
    assert tried([0.6, 0.8, 0.9], threshold=0.7)[0] == (2, False)
    assert tried([0.75, 0.8, 0.9], threshold=0.7)[0] == (1, False)
    assert tried([0.6, 0.5, 0.9], threshold=0.7)[0] == (3, False)


@pytest.mark.parametrize(
    ("scores", "expected"),
    [
        ([0.9, 0.9, 0.9], [(1, False), (2, False), (3, False)]),  # oldest first, not best first
        ([0.8, 0.6, 0.9], [(1, False), (3, False)]),
        ([0.6, 0.8, 0.6], [(2, False), (3, True)]),  # the newest is the last resort
        ([0.7, 0.8, 0.9], [(2, False), (3, False)]),  # exactly at the threshold does not pass
        ([np.nextafter(0.7, 1), 0, 0], [(1, False), (3, True)]),
        ([0.6, 0.6, 0.6], [(3, True)]),
        ([NAN, 0.8, NAN], [(2, False), (3, True)]),  # undefined never passes ...
        ([NAN, NAN, NAN], [(3, True)]),
        ([-0.9, NAN, 0.7], [(3, True)]),
    ],
)
def test_candidates_then_the_fallback(scores, expected) -> None:
    assert tried(scores, threshold=0.7) == expected


def test_undefined_passes_no_threshold() -> None:
    assert tried([NAN, NAN], threshold=-1.0, fallback="skip") == []


@pytest.mark.parametrize(
    ("fallback", "scores", "expected"),
    [
        ("previous", [0.5, 0.1, 0.3], [(3, True)]),
        ("best", [0.5, 0.1, 0.3], [(1, True)]),
        ("best", [0.5, NAN, 0.6], [(3, True)]),
        ("best", [NAN, 0.2, NAN], [(2, True)]),
        ("best", [NAN, NAN, NAN], [(3, True)]),  # nothing is best: the newest
        ("best", [0.3, 0.3, 0.1], [(1, True)]),  # the older of two equals
        ("skip", [0.5, 0.1, 0.3], []),
        ("skip", [NAN, NAN, NAN], []),
        ("best", [0.75, 0.9, 0.3], [(1, False), (2, False)]),  # the best is a candidate already
        ("skip", [0.75, 0.9, 0.3], [(1, False), (2, False)]),
        ("previous", [0.75, 0.9, 0.3], [(1, False), (2, False), (3, True)]),
    ],
)
def test_fallbacks(fallback, scores, expected) -> None:
    assert tried(scores, threshold=0.7, fallback=fallback) == expected


@pytest.mark.parametrize("fallback", ["previous", "best"])
def test_the_start_of_a_run(fallback) -> None:
    """One past scan in a window of many."""
    selector = Rbtm(window=50, threshold=0.7, fallback=fallback)
    for score, is_fallback in ((0.9, False), (0.1, True), (NAN, True)):
        (only,) = selector.select(1, np.array([0]), np.array([score])).candidates
        assert (only.model, only.is_fallback) == (0, is_fallback)


def test_models_are_scan_numbers_not_positions() -> None:
    """Keyframes, or scans left out: the window is not a run of neighbours."""
    assert tried([0.1, 0.8, 0.9], scan=40, models=[7, 21, 33]) == [(21, False), (33, False)]


def test_a_selection_says_why() -> None:
    selection = Rbtm(window=4, threshold=0.7).select(
        4, np.array([1, 2, 3]), np.array([NAN, 0.8, NAN])
    )
    candidate, fallback = selection.candidates
    assert (candidate.reason, candidate.score) == ("S > 0.7", 0.8)
    assert fallback.reason == "fallback previous" and np.isnan(fallback.score)
    assert selection.undefined == 2


def positions(window: Any, xs: list[float]) -> list[int]:
    """The scans that a window keeps of a drive along x."""
    for scan, x in enumerate(xs):
        window.push(Node(scan, 0.0, se2(x, 0, 0), descriptor=np.zeros(1)))
    return list(window.scans)


@pytest.mark.parametrize("count", [2, 4, 10])
def test_the_window_counts_the_new_scan(count) -> None:
    kept = positions(Rbtm(window=count).window(), [0.1 * i for i in range(20)])
    assert kept == list(range(20 - (count - 1), 20))


def test_a_window_larger_than_the_run_keeps_everything() -> None:
    assert positions(Rbtm(window=100).window(), [0.1] * 7) == list(range(7))


def test_keyframe_content() -> None:
    """w - 1 keyframes of at least 0.3 m of motion each."""
    xs = [0.125 * i for i in range(20)]  # every third scan is 0.375 m on
    selector = Rbtm(window=4, content="keyframes", keyframe_distance=0.3)
    assert positions(selector.window(), xs) == [12, 15, 18]


def test_every_call_of_window_gives_a_new_one() -> None:
    selector = Rbtm(window=4)
    positions(selector.window(), [0.0, 1.0])
    assert len(selector.window()) == 0
