"""Simulated sensors: distances that can be worked out by hand."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from rbtm_bench.core.geometry import se2, se3
from rbtm_bench.datasets.raycast import (
    box_mesh,
    cast,
    make_scene,
    merge,
    pillar_mesh,
    rectangle,
    scan_walls,
    walls_mesh,
)


def test_one_wall() -> None:
    scene = make_scene(walls_mesh([[(2.0, -1.0), (2.0, 1.0)]]))
    directions = [[1, 0, 0], [-1, 0, 0], [2, 1, 0], [1, 1, 0], [1, 0, 0.6]]
    ranges = cast(scene, [0.0, 0.0, 0.0], directions, max_range=10.0)
    np.testing.assert_allclose(ranges, [2, np.nan, np.sqrt(5), np.nan, np.nan], rtol=1e-6)
    assert ranges.dtype == np.float64


def test_a_wall_beyond_the_range_does_not_return() -> None:
    scene = make_scene(walls_mesh([[(2.0, -1.0), (2.0, 1.0)]]))
    assert np.isnan(cast(scene, [0, 0, 0], [1, 0, 0], max_range=1.99))
    assert cast(scene, [0.5, 0, 0], [1, 0, 0], max_range=1.99) == pytest.approx(1.5)


def test_a_planar_scan_in_a_closed_room_matches_the_formula() -> None:
    """From (x, y), heading theta, the range is the nearer of the walls in x and in y."""
    low, high = np.array([-1.0, -2.0]), np.array([3.0, 1.0])
    pose = (0.4, -0.3, 0.7)
    angles = np.deg2rad(np.arange(-180.0, 180.0, 0.1) + 0.03)
    ranges = scan_walls(rectangle(low, high), se2(*pose)[None], angles, max_range=10.0)

    heading = angles + pose[2]
    direction = np.column_stack([np.cos(heading), np.sin(heading)])
    wall = np.where(direction > 0, high, low)
    expected = ((wall - pose[:2]) / direction).min(axis=1)
    assert ranges.shape == (1, 3600)
    np.testing.assert_allclose(ranges[0], expected, atol=1e-5)


def test_beams_are_counted_from_the_heading_to_the_left() -> None:
    walls = rectangle((-1.0, -2.0), (3.0, 4.0))
    poses = np.stack([se2(0, 0, 0), se2(0, 0, np.pi / 2), se2(1, 1, np.pi)])
    ranges = scan_walls(walls, poses, np.deg2rad([-90.0, 0.0, 90.0]), max_range=10.0)
    np.testing.assert_allclose(ranges, [[2, 3, 4], [3, 4, 1], [3, 2, 3]], atol=1e-6)


def test_a_box_is_closed() -> None:
    scene = make_scene(box_mesh((-1, -2, -3), (4, 5, 6)))
    axes = np.vstack([np.eye(3), -np.eye(3)])
    np.testing.assert_allclose(cast(scene, [0, 0, 0], axes, 100.0), [4, 5, 6, 1, 2, 3], rtol=1e-6)
    every_way = np.random.default_rng(0).standard_normal((5000, 3))
    assert np.isfinite(cast(scene, [0, 0, 0], every_way, 100.0)).all()


def test_a_pillar_in_front_of_a_box() -> None:
    scene = make_scene(merge([box_mesh((-9, -9, 0), (9, 9, 3)), pillar_mesh((5, 0), 0.5, 0, 3)]))
    ranges = cast(scene, [0, 0, 1], [[1, 0, 0], [-1, 0, 0], [0, 1, 0]], 100.0)
    np.testing.assert_allclose(ranges, [4.5, 9.0, 9.0], rtol=1e-6)


def test_a_cloud_is_seen_from_the_pose_of_the_sensor() -> None:
    scene = make_scene(box_mesh((-1, -2, 0), (4, 5, 6)))
    quarter_turn = se3([0, 0, 1], [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    directions = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1]])
    turned = directions @ quarter_turn[:3, :3].T
    ranges = cast(scene, quarter_turn[:3, 3], turned, 100.0)
    np.testing.assert_allclose(ranges, [5, 1, 5, 1], rtol=1e-6)


def test_data_sets_import_without_open3d() -> None:
    modules = "corridor, carmen, cloud_folder, simulated"
    code = f"import sys; from rbtm_bench.datasets import {modules}; print('open3d' in sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "False"
