"""CARMEN logs: what is read, and what the poses mean."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from carmen_writer import PLAIN_RANGES, Write, compose, drive, flaser, odom
from hypothesis import given, settings
from hypothesis import strategies as st

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.geometry import inverse, se2
from rbtm_bench.datasets.carmen import Carmen, planar_poses

# --- what is read ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("count", "last", "spacing"),
    [(180, 89.0, 1.0), (181, 90.0, 1.0), (360, 89.5, 0.5), (361, 90.0, 0.5)],
)
def test_beam_angles(write: Write, count: int, last: float, spacing: float) -> None:
    scan = Carmen(write(flaser((0, 0, 0), ranges=[1.0 + 1e-3 * i for i in range(count)])))[0]
    assert scan.angles is not None
    degrees = np.rad2deg(scan.angles)
    assert degrees[0] == pytest.approx(-90) and degrees[-1] == pytest.approx(last)
    np.testing.assert_allclose(np.diff(degrees), spacing)


def test_a_raw_scan(write: Write) -> None:
    """Beam 90 of 180 looks straight ahead; NaN, infinity, 0 and less are no return."""
    ranges = list(PLAIN_RANGES)
    ranges[:4] = [0.0, -1.0, float("nan"), float("inf")]
    ranges[90] = 7.5
    log = Carmen(write("# a comment", "", odom((1, 2, 0.5)), flaser((1, 2, 0.5), 12.25, ranges)))
    assert (len(log), log.has_odometry, log.has_ground_truth) == (1, True, False)
    assert log.planar and log.has_beams and log.relations is None
    scan = log[0]
    assert scan.ranges is not None and scan.odometry is not None and scan.ground_truth is None
    assert scan.stamp == 12.25 and scan.planar
    assert np.flatnonzero(np.isnan(scan.ranges)).tolist() == [0, 1, 2, 3]
    assert scan.points.shape == (176, 3)
    np.testing.assert_allclose(scan.points[86], [7.5, 0, 0], atol=1e-12)
    np.testing.assert_allclose(scan.odometry, se2(1, 2, 0.5), atol=1e-15)


def test_the_laser_s_pose_is_the_odometry_of_a_raw_log(write: Write) -> None:
    """With the laser 0.3 m ahead of the robot only the second triple repeats the ODOM line."""
    poses = drive(5)
    lines = [
        line
        for i, pose in enumerate(poses)
        for line in (odom(pose), flaser(compose(pose, (0.3, 0, 0)), i, robot=pose))
    ]
    log = Carmen(write(*lines))
    assert not log.corrected and not log.has_ground_truth
    assert log.odometry is not None
    np.testing.assert_allclose(log.odometry[0], se2(0.3, 0, 0), atol=1e-15)


def corrected_lines(
    count: int, jumps: bool = True, between: int = 3
) -> tuple[list[str], list[list[float]], list[list[float]]]:
    """A corrected log as gmapping writes it; its true poses, and the odometry that was driven.

    The odometry turns too much. After each scan the ODOM lines go on from the corrected pose
    (``jumps``), or from the odometry itself.
    """
    truth, odometry = drive(count, (0.6, 0.0, 0.2)), drive(count, (0.63, 0.02, 0.3))
    lines = [odom(odometry[0]), flaser((0.5, 0, 0), 0.0)]
    truth[0] = [0.5, 0.0, 0.0]
    for i in range(1, count):
        step = (0.63 / between, 0.02 / between, 0.3 / between)
        at = truth[i - 1] if jumps else odometry[i - 1]
        for _ in range(between):
            lines.append(odom(at))
            at = compose(at, step)
        lines += [odom(at), flaser(truth[i], float(i))]
        odometry[i] = compose(odometry[i - 1], _driven(step, between))
    return [*lines, odom(truth[-1])], truth, odometry


def _driven(step: Sequence[float], times: int) -> list[float]:
    total = [0.0, 0.0, 0.0]
    for _ in range(times):
        total = compose(total, step)
    return total


@pytest.mark.parametrize("jumps", [True, False])
@pytest.mark.parametrize("corrected", ["auto", True])
def test_a_corrected_log(write: Write, jumps: bool, corrected: Any) -> None:
    """The jumps of the ODOM lines to the corrected path must not reach the odometry."""
    lines, truth, odometry = corrected_lines(12, jumps)
    log = Carmen(write(*lines), corrected=corrected)
    assert log.corrected and log.has_ground_truth and log.has_odometry
    np.testing.assert_allclose(log.ground_truth, planar_poses(np.array(truth)), atol=1e-9)
    np.testing.assert_allclose(log.odometry, planar_poses(np.array(odometry)), atol=1e-9)


def test_a_malformed_scan_takes_no_jump_into_the_odometry(write: Write) -> None:
    lines, _, odometry = corrected_lines(12)
    bad = [i for i, line in enumerate(lines) if line.startswith("FLASER")][5]
    lines[bad] = lines[bad][:300]
    log = Carmen(write(*lines), on_error="skip")
    assert log.skipped == 1
    expected = planar_poses(np.array(odometry[:5] + odometry[6:]))
    np.testing.assert_allclose(log.odometry, expected, atol=1e-9)


def test_a_corrected_log_with_nothing_but_jumps_has_no_odometry(write: Write) -> None:
    truth = drive(10, (0.6, 0.0, 0.2))
    lines = [odom((0, 0, 0))]
    for pose in truth[1:]:
        lines += [flaser(pose), odom(pose)]
    path = write(*lines)
    log = Carmen(path)
    assert log.has_ground_truth and not log.has_odometry and log[3].odometry is None
    with pytest.raises(ConfigError, match="no odometry, min_distance"):
        Carmen(path, min_distance=0.5)


def test_corrected_can_be_overruled(write: Write) -> None:
    log = Carmen(write(*corrected_lines(5)[0]), corrected=False)
    assert log.has_odometry and not log.has_ground_truth


def test_a_log_without_odom_lines_is_raw(write: Write) -> None:
    path = write("PARAM a b", *(flaser(pose, i) for i, pose in enumerate(drive(4))))
    assert not Carmen(path).corrected
    log = Carmen(path, corrected=True)
    assert log.has_ground_truth and not log.has_odometry


finite = st.floats(-1e6, 1e6, allow_nan=False)
logs = st.sampled_from([180, 181, 360, 361]).flatmap(
    lambda count: st.lists(
        st.tuples(
            st.lists(st.floats(0.11, 49.0), min_size=count, max_size=count),
            st.tuples(finite, finite, finite),
            st.floats(0, 2e9),
        ),
        min_size=1,
        max_size=4,
    )
)


@settings(max_examples=40, deadline=None)
@given(logs)
def test_whatever_is_written_is_read_back(tmp_path_factory: Any, scans: list[Any]) -> None:
    path = tmp_path_factory.mktemp("log") / "robot.clf"
    path.write_text("\n".join(flaser(pose, stamp, ranges) for ranges, pose, stamp in scans))
    log = Carmen(str(path), max_range=49.5)
    assert len(log) == len(scans)
    for scan, (ranges, pose, stamp) in zip(log, scans, strict=True):
        np.testing.assert_array_equal(scan.ranges, ranges)
        np.testing.assert_array_equal(scan.odometry, se2(*pose))
        assert not log.has_stamps or scan.stamp == stamp


# --- no return ------------------------------------------------------------------------------


def test_no_return_is_found_out(write: Write) -> None:
    """81.83 and 81.91 are both no return, 81.80 is within 0.1 m and goes with them."""
    ranges = [*PLAIN_RANGES[:160], *[81.91] * 15, 81.83, 81.83, 81.80, 81.83, 60.0]
    log = Carmen(write(*[flaser((0, 0, 0), i, ranges) for i in range(3)]))
    assert log.max_range == pytest.approx(81.81)
    assert np.isnan(log.ranges).sum() == 3 * 18
    assert log.ranges[0, 177] == 81.80


def test_the_longest_return_is_kept_where_it_is_rare(write: Write) -> None:
    log = Carmen(write(*[flaser((0, 0, 0), i) for i in range(9)]))
    assert log.max_range == np.inf and not np.isnan(log.ranges).any()


def test_the_log_s_own_maximum_counts(write: Write) -> None:
    ranges = [*PLAIN_RANGES[:179], 50.0]
    log = Carmen(write("PARAM robot_front_laser_max 50 nohost 0", flaser((0, 0, 0), 0, ranges)))
    assert log.max_range == 50.0 and np.isnan(log.ranges[0, 179])


def test_given_limits(write: Write) -> None:
    log = Carmen(write(flaser((0, 0, 0))), min_range=1.0, max_range=2.0)
    assert np.flatnonzero(np.isfinite(log.ranges[0])).tolist() == list(range(1, 100))


# --- order and thinning ---------------------------------------------------------------------


def test_order_and_stride(write: Write) -> None:
    stamps = [0.0, 2.0, 1.0, 3.0, 5.0, 4.0]
    path = write(*(flaser((stamp, 0, 0), stamp) for stamp in stamps))
    assert Carmen(path).stamps.tolist() == stamps
    assert Carmen(path, order="time").stamps.tolist() == sorted(stamps)
    log = Carmen(path, order="time", stride=2, max_scans=2)
    assert log.stamps.tolist() == [0.0, 2.0]
    odometry = log[1].odometry
    assert odometry is not None and odometry[0, 3] == 2.0 and log[1].index == 1


@pytest.mark.parametrize(
    ("setting", "kept"),
    [
        ({"min_distance": 0.25}, [0, 3, 6, 9]),
        ({"min_angle_deg": 90.0}, [0, 7, 8]),
        ({"min_distance": 0.45, "min_angle_deg": 90.0}, [0, 5, 7, 8]),
        ({"min_distance": 0.25, "stride": 2}, [0, 4, 8]),
    ],
)
def test_thinning(write: Write, setting: dict[str, Any], kept: list[int]) -> None:
    """Ten steps of 0.1 m; scan 7 looks 100 deg (across +-180) to the side."""
    heading = [3.1] * 7 + [3.1 + np.deg2rad(100) - 2 * np.pi] + [3.1] * 2
    path = write(*(flaser((0.1 * i, 0, a), i) for i, a in enumerate(heading)))
    assert Carmen(path, **setting).stamps.tolist() == kept


def test_a_log_that_has_lost_its_times(write: Write) -> None:
    path = write(*(flaser((i, 0, 0), 1.13486e09) for i in range(4)))
    log = Carmen(path)
    assert not log.has_stamps
    assert [scan.stamp for scan in log] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    with pytest.raises(ConfigError, match="lost its times"):
        Carmen(path, order="time")


@pytest.mark.parametrize("index", [-1, 1])
def test_there_is_no_scan_before_the_first_or_after_the_last(write: Write, index: int) -> None:
    with pytest.raises(IndexError):
        Carmen(write(flaser((0, 0, 0))))[index]


def test_the_log_s_own_frame_is_kept(write: Write) -> None:
    log = Carmen(write(flaser((5, 6, 1), 0.0), flaser((5.1, 6, 1), 1.0)))
    assert log.odometry is not None
    step = inverse(log.odometry[0]) @ log.odometry[1]
    np.testing.assert_allclose(step[:2, 3], [0.1 * np.cos(1), -0.1 * np.sin(1)], atol=1e-9)
    np.testing.assert_allclose(log.odometry[0], se2(5, 6, 1))
