"""KittiErrors by hand, by KISS-ICP's own functions and by the definition itself."""

from __future__ import annotations

import numpy as np
import pytest
from kiss_icp.metrics import absolute_trajectory_error, sequence_error

from rbtm_bench.core.geometry import inverse, rotation_angle, se2
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array
from rbtm_bench.metrics.ape import Ape
from rbtm_bench.metrics.kitti import KittiErrors

SEGMENTS = ("kitti_translation_percent", "kitti_rotation_deg_per_m")
FITTED = ("ate_translation_m", "ate_rotation_deg")
KISS_PI = np.pi / 3.14
"""By how much KISS-ICP's degrees are too large."""


def drive(poses: int, step_m: float, turn_deg: float = 0.0) -> Trajectory:
    """Steps of equal length and turn, a pose a second."""
    step = se2(step_m, 0.0, np.radians(turn_deg))
    T = [np.eye(4)]
    for _ in range(poses - 1):
        T.append(T[-1] @ step)
    return Trajectory(np.arange(poses, dtype=float), np.stack(T))


def by_definition(truth: Array, estimate: Array) -> tuple[float, float]:
    """Geiger et al. 2012: % and deg/m over the segments of 100, 200, ... 800 m."""
    lengths = np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1)
    travelled = np.concatenate([[0.0], np.cumsum(lengths)])
    translation, rotation = [], []
    for first in range(0, len(truth), 10):
        for length in range(100, 801, 100):
            beyond = np.flatnonzero(travelled > travelled[first] + length)
            if len(beyond):
                G, E = (inverse(T[first]) @ T[beyond[0]] for T in (truth, estimate))
                off = inverse(E) @ G
                translation.append(np.linalg.norm(off[:3, 3]) / length)
                rotation.append(np.degrees(float(rotation_angle(off))) / length)
    return 100.0 * float(np.mean(translation)), float(np.mean(rotation))


def test_one_segment_by_hand():
    """The only segment starts at pose 0 and ends at the first pose beyond 100 m, the 102nd. There
    the estimate is 1.01 m too far, of 100 m; or has turned by 101 x 0.02 deg."""
    values = KittiErrors().evaluate(drive(102, 1.01), drive(102, 1.0))
    assert values["kitti_translation_percent"] == pytest.approx(1.01, rel=1e-6)
    assert values["kitti_rotation_deg_per_m"] == 0.0
    values = KittiErrors().evaluate(drive(102, 1.0, 0.02), drive(102, 1.0))
    assert values["kitti_rotation_deg_per_m"] == pytest.approx(0.0202 * KISS_PI, rel=1e-5)


@pytest.mark.parametrize("poses", [2, 50, 101])
def test_a_path_of_100_m_or_less_has_no_segment(poses):
    values = KittiErrors().evaluate(drive(poses, 1.01, 0.1), drive(poses, 1.0, 0.1))
    assert [values[key] for key in SEGMENTS] == [None, None]


def test_segments_are_those_of_the_true_path():
    """An estimate that is long enough does not make the path so."""
    values = KittiErrors().evaluate(drive(80, 2.0), drive(80, 1.0))
    assert [values[key] for key in SEGMENTS] == [None, None]
    values = KittiErrors().evaluate(drive(120, 0.5), drive(120, 1.0))
    assert values["kitti_translation_percent"] == pytest.approx(50.5, rel=1e-6)


def test_numbers_are_those_of_kiss_icp_and_of_the_definition(wander):
    walk, other = (wander(1500, seed).T_world_scan for seed in (1, 2))
    truth, estimate = walk.copy(), walk @ inverse(inverse(walk[0]) @ other[0])
    truth[:, :3, 3] *= 2.0  # about 1.2 km
    estimate[:, :3, 3] = 2.02 * estimate[:, :3, 3] + 0.1 * other[:, :3, 3]
    stamps = np.arange(1500.0)
    values = KittiErrors().evaluate(Trajectory(stamps, estimate), Trajectory(stamps, truth))
    kiss = sequence_error(truth, estimate)
    assert [values[key] for key in SEGMENTS] == pytest.approx(list(kiss), rel=1e-6)
    translation, rotation = by_definition(truth, estimate)
    assert values["kitti_translation_percent"] == pytest.approx(translation, rel=1e-5)
    assert values["kitti_rotation_deg_per_m"] == pytest.approx(rotation * KISS_PI, rel=1e-5)
    angle, distance = absolute_trajectory_error(truth, estimate)
    assert values["ate_translation_m"] == pytest.approx(distance, rel=1e-6)
    assert values["ate_rotation_deg"] == pytest.approx(np.degrees(angle), rel=1e-6)


def test_scans_without_a_truth_are_left_out():
    truth, estimate = drive(300, 1.0, 0.3), drive(300, 1.01, 0.31)
    whole = KittiErrors().evaluate(estimate, truth)
    for trajectory in (truth, estimate):
        trajectory.T_world_scan[250:] = np.nan
    part = KittiErrors().evaluate(estimate, truth)
    cut = [Trajectory(t.stamps[:250], t.T_world_scan[:250]) for t in (estimate, truth)]
    assert part == KittiErrors().evaluate(*cut) != whole


def test_fitted_translation_is_evo_s(wander):
    truth, estimate = wander(80, 3), wander(80, 4)
    values = KittiErrors().evaluate(estimate, truth)
    fitted = Ape("umeyama").evaluate(estimate, truth)["ape_rmse_m"]
    assert values["ate_translation_m"] == pytest.approx(fitted, rel=1e-6)


def test_fitted_rotation_by_hand(planar):
    """Positions that fit exactly, and every second orientation off by 10 deg."""
    corners = [(1, 0), (0, 1), (-1, 0), (0, -1)]
    truth = planar([(x, y, 0) for x, y in corners])
    estimate = planar([(x + 5, y - 3, 10 * (i % 2)) for i, (x, y) in enumerate(corners)])
    values = KittiErrors().evaluate(estimate, truth)
    assert values["ate_translation_m"] == pytest.approx(0.0, abs=1e-6)
    assert values["ate_rotation_deg"] == pytest.approx(np.sqrt(100 / 2), rel=1e-6)


def test_a_straight_path_leaves_the_fit_open():
    values = KittiErrors().evaluate(drive(102, 1.01), drive(102, 1.0))
    assert [values[key] for key in FITTED] == [None, None]
