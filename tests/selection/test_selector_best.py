"""The most similar of the window."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rbtm_bench.selection.best import Best

NAN = float("nan")


def tried(scores: list[float], **settings: Any) -> list[tuple[int, bool]]:
    """(model scan, is it the fallback) in the order in which they are to be tried."""
    selector = Best(window=len(scores) + 1, **settings)
    models = np.arange(10, 10 + len(scores))
    selection = selector.select(10 + len(scores), models, np.array(scores))
    return [(c.model, c.is_fallback) for c in selection.candidates]


@pytest.mark.parametrize(
    ("scores", "expected"),
    [
        ([0.2, 0.9, 0.5], [(11, False), (12, False), (10, False)]),
        ([0.5, 0.9, 0.9], [(11, False), (12, False), (10, False)]),  # the older of equals
        ([-0.9, NAN, -0.5], [(12, False), (10, False)]),  # undefined is never the best
        ([0.3, 0.9, NAN], [(11, False), (10, False), (12, True)]),
        ([NAN, NAN], [(11, True)]),
    ],
)
def test_most_similar_first(scores, expected) -> None:
    assert tried(scores) == expected


def test_a_threshold_leaves_the_rest_to_the_fallback() -> None:
    scores = [0.9, 0.8, 0.7, 0.1]  # exactly at the threshold does not pass
    assert tried(scores, threshold=0.7) == [(10, False), (11, False), (13, True)]
    assert tried(scores, threshold=0.7, fallback="skip") == [(10, False), (11, False)]
    assert tried(scores, threshold=0.95, fallback="best") == [(10, True)]


def test_it_says_why() -> None:
    selection = Best(window=3).select(7, np.array([4, 6]), np.array([0.1, 0.9]))
    assert [c.reason for c in selection.candidates] == [
        "rank 1 by similarity",
        "rank 2 by similarity",
    ]
    assert [c.score for c in selection.candidates] == [0.9, 0.1]


def test_the_window_counts_the_new_scan_and_may_hold_keyframes() -> None:
    assert Best(window=5).window().capacity == 4
    assert Best(window=5).window().keyframes is None
    rule = Best(content="keyframes", keyframe_distance=0.4).window().keyframes
    assert rule is not None and rule.distance == 0.4
