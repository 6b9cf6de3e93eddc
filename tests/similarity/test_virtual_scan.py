"""Clouds seen as laser scans: the projection by hand, and who may use what."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.similarity.curvature import Curvature
from rbtm_bench.similarity.curvature_circular import CurvatureCircular
from rbtm_bench.similarity.virtual_scan import VirtualScan

BINS = 16
BIN = 2 * np.pi / BINS


class Empty(Dataset):
    """A data set of no scans, planar or not, with beams or without."""

    def __init__(self, planar: bool, has_beams: bool) -> None:
        self.planar, self.has_beams = planar, has_beams

    def __len__(self) -> int:
        return 0

    def __getitem__(self, index: int) -> Scan:
        raise IndexError

    def fingerprint(self) -> str:
        return ""


def at(*points: tuple[float, float, float]) -> Array:
    """Points of (azimuth in bins from -pi, range, height)."""
    azimuth, r, z = np.array(points, dtype=float).T
    angle = -np.pi + azimuth * BIN
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z])


def project(points: Array, **settings: Any) -> dict[int, float]:
    """The bins with a return, rounded."""
    ranges = VirtualScan(bins=BINS, **settings).project(points)
    assert ranges.shape == (BINS,)
    return {int(i): round(float(ranges[i]), 9) for i in np.flatnonzero(np.isfinite(ranges))}


def test_the_nearest_return_of_each_bin() -> None:
    points = at((3.1, 5, 0), (3.9, 2, 0.1), (3.5, 7, -0.2), (4.1, 4, 0), (12.5, 1, 0))
    assert project(points) == {3: 2, 4: 4, 12: 1}


def test_the_range_is_horizontal() -> None:
    assert project(np.array([[3.0, 4.0, 0.4]])) == {10: 5}


@pytest.mark.parametrize(
    ("height", "inside"), [(-0.5, True), (-0.501, False), (0.499, True), (0.5, False), (0.0, True)]
)
def test_the_height_band_has_its_lower_edge_only(height, inside) -> None:
    assert bool(project(at((3.5, 2, height)))) == inside


def test_the_height_band_is_a_setting() -> None:
    points = at((3.5, 2, 0), (5.5, 2, 1.2))
    assert project(points, min_height_m=1.0, max_height_m=1.5) == {5: 2}


@pytest.mark.parametrize(
    ("x", "y", "bin_"),
    [
        (-1.0, 0.0, 0),  # azimuth +pi is -pi
        (-1.0, -0.0, 0),
        (-1.0, -1e-9, 0),
        (-1.0, 1e-9, 15),
        (1.0, 0.0, 8),
        (1.0, -1e-9, 7),
        (0.0, 1.0, 12),
    ],
)
def test_bins_begin_at_minus_pi_and_wrap(x, y, bin_) -> None:
    assert project(np.array([[x, y, 0.0]])) == {bin_: 1}


def test_an_empty_band_is_a_scan_without_returns() -> None:
    assert project(at((3.5, 2, 9))) == {}
    assert project(np.zeros((0, 3))) == {}
    similarity = VirtualScan()
    nothing = similarity.describe(Scan(0, 0.0, at((3.5, 2, 9))))
    assert not nothing.any()
    assert np.isnan(similarity.scores(nothing[None], nothing)[0])


def test_a_cloud_is_compared_like_the_scan_it_stands_for(room) -> None:
    """Points at the bins' centres, above and below the band and behind: the same descriptor as
    the laser's."""
    angles = -np.pi + np.radians(np.arange(360) + 0.5)
    ranges = room(angles)
    wall = np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles), np.zeros(360)])
    clutter = [0.5 * wall + [0, 0, 1.0], 0.5 * wall - [0, 0, 1.0], 1.3 * wall]
    cloud = Scan(0, 0.0, np.concatenate([wall, *clutter]))
    expected = CurvatureCircular(half_span_deg=4.0).describe_beams(ranges, angles)
    got = VirtualScan(half_span_deg=4.0).describe(cloud)
    np.testing.assert_allclose(got, expected, atol=1e-9)


@pytest.mark.parametrize("turn", [-20, 5, 40])
def test_a_turned_cloud_is_found_by_lags(room, turn) -> None:
    def cloud(turn_deg: float) -> Scan:
        angles = -np.pi + np.radians(np.arange(360) + 0.5)
        r = room((angles + np.radians(turn_deg) + np.pi) % (2 * np.pi) - np.pi)
        return Scan(0, 0.0, np.column_stack([r * np.cos(angles), r * np.sin(angles), 0 * r]))

    scores = {}
    for most in (0.0, 45.0):
        similarity = VirtualScan(half_span_deg=3.0, max_lag_deg=most, lag_phase="consistent")
        one, other = similarity.describe(cloud(0)), similarity.describe(cloud(turn))
        scores[most] = float(similarity.scores(one[None], other)[0])
    assert scores[45.0] > 0.98 and scores[45.0] > scores[0.0] + 0.05


def test_planar_scans_have_no_height_band() -> None:
    with pytest.raises(ConfigError, match="is planar: use similarity=curvature_circular"):
        VirtualScan().check(Empty(planar=True, has_beams=True))
    VirtualScan().check(Empty(planar=False, has_beams=False))


@pytest.mark.parametrize("similarity", [Curvature(), CurvatureCircular()])
def test_clouds_have_no_order_of_sensing(similarity) -> None:
    with pytest.raises(ConfigError, match=r"\(Empty\) does not have: use similarity=virtual_scan"):
        similarity.check(Empty(planar=False, has_beams=False))
    similarity.check(Empty(planar=True, has_beams=True))


def test_an_upside_down_height_band_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"max_height_m=0.2: expected more than min_height_m=0.2"):
        VirtualScan(min_height_m=0.2, max_height_m=0.2)
