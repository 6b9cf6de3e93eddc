"""Scans as ranges over bearings, against geometry done by hand."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.backends.polar_scan import Bins, bins_of, polar_scan, project
from rbtm_bench.core.types import Array

HERE = (0.0, 0.0, 0.0)


def fan(ranges: Array, degrees: Array) -> Array:
    """Points (N, 3) at ranges (N,) m and bearings (N,) deg."""
    turn = np.deg2rad(degrees)
    return np.column_stack([ranges * np.cos(turn), ranges * np.sin(turn), np.zeros(len(turn))])


def circle_bins() -> Bins:
    """A bin a degree, the first at 0 deg."""
    return bins_of(fan(np.ones(360), np.arange(360.0)), None)


def seen(points: Array, bins: Bins, pose: tuple[float, float, float] = HERE) -> Array:
    """Ranges (B,) of points from ``pose``, without limits of range."""
    return project(polar_scan(points, bins, 0.0, np.inf, 0.2), bins, pose, 0.0)


@pytest.mark.parametrize("spacing", [0.25, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("first", [-90.0, -179.7])
def test_bins_are_the_beams(spacing: float, first: float) -> None:
    degrees = np.arange(first, first + 180.0, spacing)
    points = fan(np.linspace(2, 9, len(degrees)), degrees)
    bins = bins_of(np.random.default_rng(0).permutation(points), None)
    assert len(bins.cosine) == round(360 / spacing)
    assert np.rad2deg(bins.step) == pytest.approx(spacing)
    place = (degrees - np.rad2deg(bins.origin)) / spacing
    np.testing.assert_allclose(place, place.round(), atol=1e-6)


def test_lost_returns_do_not_change_the_spacing() -> None:
    degrees = np.delete(np.arange(-90.0, 90.0), [3, 4, 5, 60, 61, 120])
    assert len(bins_of(fan(np.full(len(degrees), 3.0), degrees), None).cosine) == 360


def test_a_number_of_bins_may_be_given() -> None:
    bins = bins_of(fan(np.ones(10), np.arange(10.0)), 720)
    assert len(bins.sine) == 720
    assert bins.step == pytest.approx(np.pi / 360)


def test_a_wall_seen_from_elsewhere() -> None:
    """A wall at x = 3, seen from 1 m nearer and 0.2 rad turned: range 2 / cos(bearing + turn)."""
    degrees = np.arange(-60.0, 61.0)
    wall = fan(3.0 / np.cos(np.deg2rad(degrees)), degrees)
    bins = bins_of(wall, None)
    ranges = seen(wall, bins, (-1.0 * np.cos(0.2), 1.0 * np.sin(0.2), -0.2))
    bearing = bins.origin + bins.step * np.arange(len(ranges))
    inside = np.abs(np.angle(np.exp(1j * bearing))) < np.deg2rad(50)
    expected = 2.0 / np.cos(bearing[inside] + 0.2)
    np.testing.assert_allclose(ranges[inside], expected, rtol=2e-3)  # the filter trims two beams


def test_a_scan_seen_from_its_own_place_is_itself() -> None:
    ranges = 4.0 + 0.5 * np.sin(np.deg2rad(3 * np.arange(360.0)))
    bins = circle_bins()
    assert not np.isinf(seen(fan(ranges, np.arange(360.0)), bins)).any()
    own = seen(fan(ranges, np.arange(360.0)), bins)
    off = np.abs(own - ranges)
    assert off.max() < 0.002  # a median of five rounds off the crests
    assert np.median(off) < 1e-12


def test_what_lies_behind_is_hidden() -> None:
    """A box 2 m in front of a wall at 5 m: from 3 m to the side the box hides another part."""
    degrees = np.arange(-80.0, 81.0)
    turn = np.deg2rad(degrees)
    ranges = np.where(np.abs(degrees) <= 10, 2.0 / np.cos(turn), 5.0 / np.cos(turn))
    points = fan(ranges, degrees)
    bins = bins_of(points, None)
    from_side = seen(points, bins, (0.0, 3.0, 0.0))  # the place is at y = -3
    box, shadow, wall = (
        from_side[round((np.deg2rad(d) - bins.origin) / bins.step) % len(from_side)]
        for d in (56.0, 30.0, 20.0)
    )
    assert box == pytest.approx(2.0 / np.cos(np.deg2rad(56)), rel=1e-3)  # not the wall at 8.9 m
    assert np.isinf(shadow)  # the wall behind the box was never seen
    assert wall == pytest.approx(5.0 / np.cos(np.deg2rad(20)), rel=1e-3)


def test_surfaces_end_at_a_jump() -> None:
    """Between the box's edge and the wall lies nothing to see."""
    degrees = np.arange(-40.0, 41.0)
    points = fan(np.where(degrees < 0, 2.0, 5.0), degrees)
    bins = bins_of(points, None)
    scan = polar_scan(points, bins, 0.0, np.inf, 0.2)
    assert scan.joined.sum() == len(degrees) - 2  # all but the jump and the open end
    ranges = seen(points, bins, (-0.5, 0.5, 0.0))
    assert not ((ranges > 2.5) & (ranges < 4.0)).any()


def test_a_wall_at_a_grazing_angle_is_one_surface() -> None:
    """Its ranges jump by more than 0.2 m, but go on as they did before."""
    degrees = np.arange(60.0, 81.0)
    ranges = 1.0 / np.cos(np.deg2rad(degrees))
    scan = polar_scan(fan(ranges, degrees), circle_bins(), 0.0, np.inf, 0.2)
    assert np.diff(ranges).max() > 0.5
    kept = scan.joined[:-2]  # the filter levels the last three
    assert kept[:-1].all()


def test_the_back_of_a_surface_is_not_seen() -> None:
    degrees = np.arange(-30.0, 31.0)
    wall = fan(2.0 / np.cos(np.deg2rad(degrees)), degrees)
    bins = bins_of(wall, None)
    assert np.isfinite(seen(wall, bins)).any()
    assert np.isinf(seen(wall, bins, (-4.0, 0.0, 0.0))).all()  # from behind it


def test_a_back_hides_what_is_behind_it() -> None:
    """From the far side of the near wall the far one cannot be seen through it."""
    degrees = np.arange(-30.0, 31.0)
    turn = np.deg2rad(degrees)
    far = fan(6.0 / np.cos(turn), degrees)
    near = fan(2.0 / np.cos(turn), degrees)
    bins = bins_of(far, None)
    pose = (-8.0, 0.0, 0.0)  # 2 m beyond the far wall, which shows its back
    assert np.isinf(seen(far, bins, pose)).all()
    both = polar_scan(np.concatenate([near[:20], far[20:]]), bins, 0.0, np.inf, 0.2)
    assert np.isinf(project(both, bins, pose, 0.0)).all()


def test_a_lonely_reading_is_filtered_away() -> None:
    """A chair's leg, one beam wide, in front of a wall."""
    degrees = np.arange(360.0)
    ranges = np.full(360, 3.0)
    ranges[100] = 1.0
    filtered = seen(fan(ranges, degrees), circle_bins())
    np.testing.assert_allclose(filtered, 3.0, atol=1e-9)


def test_of_several_points_in_a_bin_the_nearest_surface_counts() -> None:
    """Two walls from two scans, and the near one seen twice with noise: its mean."""
    degrees = np.arange(360.0)
    points = [fan(np.full(360, r), degrees) for r in (2.02, 5.0, 1.98)]
    ranges = seen(np.concatenate(points), circle_bins())
    np.testing.assert_allclose(ranges, 2.0, atol=1e-9)


def test_ranges_have_limits() -> None:
    degrees = np.arange(360.0)
    ranges = np.where(degrees < 120, 0.05, np.where(degrees < 240, 3.0, 12.0))
    scan = polar_scan(fan(ranges, degrees), circle_bins(), 0.1, 10.0, 0.2)
    assert len(scan.xy) == 120
    np.testing.assert_allclose(np.linalg.norm(scan.xy, axis=1), 3.0)


def test_a_full_circle_closes() -> None:
    scan = polar_scan(fan(np.full(360, 3.0), np.arange(360.0)), circle_bins(), 0.0, np.inf, 0.2)
    assert scan.joined.all()
    half = polar_scan(fan(np.full(181, 3.0), np.arange(181.0)), circle_bins(), 0.0, np.inf, 0.2)
    assert half.joined.sum() == 180


def test_no_points_are_no_surface() -> None:
    scan = polar_scan(np.zeros((0, 3)), circle_bins(), 0.0, np.inf, 0.2)
    assert len(scan.xy) == 0
    assert np.isinf(project(scan, circle_bins(), HERE, 0.0)).all()
