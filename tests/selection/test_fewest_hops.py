"""The shortest chain to the start: RBTM's oldest on a way out, another scan on a way back."""

from __future__ import annotations

import numpy as np
import pytest
from loop_helpers import Perfect, Script, drive, method

from rbtm_bench.core.geometry import se2
from rbtm_bench.core.types import Node
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.selection.base import Selection, Selector
from rbtm_bench.selection.fewest_hops import FewestHops
from rbtm_bench.selection.rbtm import Rbtm

NAN = float("nan")


def chosen(hops: list[int], scores: list[float], **settings) -> Selection:
    """Scans 20, 21, ... with chains of so many hops."""
    selector = FewestHops(window=len(hops) + 1, threshold=0.5, **settings)
    window = selector.window()
    for number, count in enumerate(hops, start=20):
        window.push(Node(number, 0.0, se2(0, 0, 0), descriptor=np.zeros(1), hops=count))
    return selector.choose(20 + len(hops), window, np.array(scores))


@pytest.mark.parametrize(
    ("hops", "scores", "expected"),
    [
        ([5, 3, 4], [0.9, 0.9, 0.9], [21, 22, 20]),
        ([5, 3, 4], [0.9, 0.5, 0.9], [22, 20]),  # at the threshold: not a candidate
        ([5, 3, 4], [0.9, NAN, 0.6], [22, 20]),
        ([3, 3, 3], [0.6, 0.9, 0.8], [21, 22, 20]),  # equals: the most similar
        ([3, 3, 3], [0.8, 0.8, 0.6], [20, 21, 22]),  # equal in all: the older
    ],
)
def test_order(hops, scores, expected) -> None:
    selection = chosen(hops, scores, fallback="skip")
    assert [c.model for c in selection.candidates] == expected


def test_reason_and_fallback() -> None:
    first, last = chosen([5, 3], [0.6, 0.1]).candidates
    assert (first.reason, first.score) == ("5 hops, S > 0.5", 0.6)
    assert (last.model, last.is_fallback) == (21, True)


def test_numbers_alone_are_not_enough() -> None:
    with pytest.raises(TypeError, match="FewestHops"):
        FewestHops().select(3, np.arange(3), np.ones(3))


PLACES = [0, 1, 2, 3, 2, 1, 0, 1]
"""Out, back, and out again: where each scan is taken."""
ALIKE = {
    (model, scan): 0.9 if abs(PLACES[model] - PLACES[scan]) <= 1 else 0.1
    for scan in range(len(PLACES))
    for model in range(scan)
}


def models(selector: Selector) -> list[int | None]:
    steps = odometry(drive(len(PLACES)), method(Perfect(), selector, Script(ALIKE)))
    return [step.record.model for step in steps]


def test_on_a_returning_path_it_is_not_the_oldest() -> None:
    """Scan 5 is back beside the start and hangs on scan 0: one hop. When scan 7 comes, RBTM takes
    the oldest that is similar, 2, with two hops: out along the first way. Until then they agree.
    """
    assert models(Rbtm(window=6, threshold=0.5)) == [None, 0, 1, 2, 1, 0, 1, 2]
    assert models(FewestHops(window=6, threshold=0.5)) == [None, 0, 1, 2, 1, 0, 1, 5]


def test_hops_of_the_loop() -> None:
    """A node's hops are its model's and one more; a predicted scan hangs on the one before it."""
    seen: dict[int, int] = {}

    class Recording(FewestHops):
        def choose(self, scan, window, scores):
            seen.update({node.scan: node.hops for node in window.nodes})
            return super().choose(scan, window, scores)

    backend = Perfect(lost=[(2, 3), (1, 3), (0, 3)])
    table = {(0, 1): 0.9, (1, 2): 0.9, (2, 3): 0.9, (0, 4): 0.9, (3, 5): 0.9}
    scans = drive(7)
    list(odometry(scans, method(backend, Recording(9, threshold=0.5), Script(table))))
    assert seen == {0: 0, 1: 1, 2: 2, 3: 3, 4: 1, 5: 4}
