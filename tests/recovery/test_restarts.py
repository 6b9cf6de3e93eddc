"""Other starts, by hand: halves, rest, a search that reaches where the guess does not."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.backends.none import NoRegistration
from rbtm_bench.core.geometry import inverse, se2, transform
from rbtm_bench.core.types import Scan
from rbtm_bench.recovery.restarts import Restarts, halfway

CORNER = np.array(
    [[x, 2.0, 0.0] for x in np.linspace(-2, 3, 60)]
    + [[3.0, y, 0.0] for y in np.linspace(-1, 2, 40)]
)


def prepared(points: np.ndarray):
    return NoRegistration().prepare(Scan(0, 0.0, points, planar=True))


def test_half_a_motion() -> None:
    np.testing.assert_allclose(halfway(np.eye(4), se2(2.0, 0.0, 0.0)), se2(1.0, 0.0, 0.0))
    half = halfway(se2(1.0, 1.0, np.pi / 2), se2(1.0, 3.0, np.pi / 2) @ se2(0, 0, 0.4))
    np.testing.assert_allclose(half, se2(1.0, 2.0, np.pi / 2) @ se2(0, 0, 0.2), atol=1e-12)


def test_which_starts_and_in_which_order() -> None:
    scan = prepared(CORNER)
    guess, rest = se2(0.4, 0.0, 0.1), se2(0.1, 0.0, 0.0)
    names = [name for name, _ in Restarts().restarts(scan, scan, guess, rest)]
    assert names == ["half", "rest", "search"]
    (lone,) = Restarts(half=False, translation=0.0).restarts(scan, scan, guess, rest)
    assert lone.name == "rest" and lone.T_target_source is rest


@pytest.mark.parametrize("off", [se2(0.7, -0.6, 0.3), se2(-0.8, 0.2, -0.4)])
def test_a_wide_search_ends_near_the_truth(off: np.ndarray) -> None:
    truth = se2(0.3, 0.1, 0.05)
    target, source = prepared(CORNER), prepared(transform(inverse(truth), CORNER))
    (start,) = Restarts(half=False, rest=False).restarts(source, target, truth @ off, truth)
    np.testing.assert_allclose(start.T_target_source, truth, atol=0.06)
