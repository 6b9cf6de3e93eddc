"""csm_2d without a guess, and what its information says."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.backends.csm_2d import CorrelativeScanMatching
from rbtm_bench.contract.scene import cast, planar_scan
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import inverse, rotation_angle, se2, translation_norm
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import beam_points

START = se2(0.3, -0.2, 0.2)


@pytest.fixture(scope="module")
def everywhere() -> CorrelativeScanMatching:
    return CorrelativeScanMatching(max_translation=None, max_rotation_deg=None)


@pytest.mark.parametrize("degrees", [-170.0, -60.0, 95.0, 180.0])
def test_a_global_search_needs_no_guess(
    everywhere: CorrelativeScanMatching, degrees: float
) -> None:
    T = se2(1.1, 0.6, np.deg2rad(degrees))
    source = everywhere.prepare(planar_scan(START @ T, 1, 0.01))
    target = everywhere.prepare(planar_scan(START, 0, 0.01))
    for guess in (np.eye(4), se2(30.0, -20.0, 1.0)):
        off = inverse(T) @ everywhere.register(source, target, guess).T_target_source
        assert translation_norm(off) < 0.03 and np.degrees(rotation_angle(off)) < 1.0
    assert not everywhere.uses_guess


def test_the_window_bounds_the_answer() -> None:
    backend = CorrelativeScanMatching(max_translation=0.2, max_rotation_deg=5.0)
    T = se2(1.1, 0.6, 1.0)
    source = backend.prepare(planar_scan(START @ T, 1))
    target = backend.prepare(planar_scan(START, 0))
    moved = backend.register(source, target, np.eye(4)).T_target_source
    assert np.abs(moved[:2, 3]).max() <= 0.2 + 1.5 * 0.05
    assert np.degrees(rotation_angle(moved)) < 6.5


def corridor(T: Array, index: int) -> Scan:
    """A corridor without ends, along x."""
    walls = np.array([[[-100.0, -1.0], [100.0, -1.0]], [[-100.0, 1.2], [100.0, 1.2]]])
    angles = np.deg2rad(np.arange(-120.0, 121.0))
    ranges = cast(walls, T, angles)
    ranges[ranges > 5.0] = np.nan
    return Scan(index, 0.1 * index, beam_points(ranges, angles), True, ranges, angles)


def test_the_information_is_of_the_source_frame_and_small_along_a_corridor() -> None:
    backend = CorrelativeScanMatching(max_translation=0.3)
    turn = se2(0.0, 0.0, 0.5)  # the corridor lies along (cos .5, -sin .5) of the source
    target, source = backend.prepare(corridor(np.eye(4), 0)), backend.prepare(corridor(turn, 1))
    alignment = backend.register(source, target, turn)
    information = alignment.information
    assert information is not None and alignment.converged
    along, across = np.zeros(6), np.zeros(6)
    along[:2], across[:2] = (np.cos(0.5), -np.sin(0.5)), (np.sin(0.5), np.cos(0.5))
    assert across @ information @ across > 20 * (along @ information @ along)
    # points on the walls whose distances scatter by sigma would give n / sigma^2 across
    most = len(backend.matcher.points(source)) / 0.1**2
    assert 0.2 * most < across @ information @ across < 1.2 * most
    assert np.linalg.eigvalsh(information)[0] > -1e-6 * np.linalg.eigvalsh(information)[-1]


def test_a_poor_score_has_not_converged() -> None:
    strict = CorrelativeScanMatching(min_score=0.99)
    source, target = (strict.prepare(planar_scan(START, i, 0.03)) for i in range(2))
    alignment = strict.register(source, target, np.eye(4))
    assert alignment.converged is False
    assert alignment.library_fitness is not None and 0.5 < alignment.library_fitness < 0.99


def test_points_too_far_apart_for_a_table_are_an_error() -> None:
    backend = CorrelativeScanMatching()
    scan = planar_scan(START, 0)
    scan.points[0, :2] = 1e6
    target = backend.prepare(scan)
    with pytest.raises(BackendError, match="too far apart"):
        backend.register(backend.prepare(planar_scan(START, 1)), target, np.eye(4))
