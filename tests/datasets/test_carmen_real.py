"""The real logs: counts, no-return shares, relations, and odometry that is no ground truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rbtm_bench.core.geometry import inverse, rotation_angle, translation_norm
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.carmen import Carmen

RAW = {
    "aces": (7374, 180, 0.0084, 1279),
    "intel": (13631, 180, 0.0278, 2984),
    "mit-csail": (1988, 361, 0.0330, 1172),
}
CORRECTED = {
    "aces": (440, 180, 0.0078),
    "csail": (406, 361, 0.0267),
    "freiburg-101": (292, 360, 0.1194),
    "intel": (910, 180, 0.0255),
    "orebro": (237, 181, 0.0226),
}


def steps(poses: Array | None) -> Array:
    assert poses is not None
    return inverse(poses[:-1]) @ poses[1:]


@pytest.mark.parametrize("name", sorted(RAW))
def test_raw_logs(data_dir: Path, name: str) -> None:
    scans, beams, no_return, relations = RAW[name]
    folder = data_dir / "freiburg"
    log = Carmen(str(folder / f"{name}.clf.gz"), str(folder / f"{name}.relations"))
    assert log.ranges.shape == (scans, beams)
    assert (log.has_odometry, log.has_ground_truth, log.has_stamps) == (True, False, True)
    assert np.isnan(log.ranges).mean() == pytest.approx(no_return, abs=1e-4)
    assert np.nanmax(log.ranges) < 50
    known = log.relations
    assert known is not None and len(known) == relations
    stamps = np.sort(log.stamps)
    for wanted in (known.start, known.end):
        after = np.searchsorted(stamps, wanted).clip(1, len(stamps) - 1)
        nearest = np.minimum(np.abs(stamps[after] - wanted), np.abs(stamps[after - 1] - wanted))
        assert nearest.max() < 1e-3


@pytest.mark.parametrize("name", sorted(CORRECTED))
def test_corrected_logs(data_dir: Path, name: str) -> None:
    scans, beams, no_return = CORRECTED[name]
    log = Carmen(str(data_dir / "corrected" / f"{name}-corrected.log.gz"))
    assert log.ranges.shape == (scans, beams)
    assert log.corrected and log.has_ground_truth
    assert np.isnan(log.ranges).mean() == pytest.approx(no_return, abs=1e-4)
    # These two were written with six digits, or none, of their times.
    assert log.has_stamps == (name not in ("csail", "orebro"))
    # Orebro's ODOM lines only repeat the corrected pose of the scan before.
    assert log.has_odometry == (name != "orebro")
    if log.has_odometry:
        difference = inverse(steps(log.ground_truth)) @ steps(log.odometry)
        assert 0.02 < translation_norm(difference).mean() < 0.5
        assert 1.0 < np.rad2deg(rotation_angle(difference).mean()) < 10.0


@pytest.mark.parametrize("name", ["aces", "intel"])
def test_the_odometry_of_a_corrected_log_is_that_of_the_raw_log(data_dir: Path, name: str) -> None:
    """The same run in two files: ODOM lines taken as they stand would be 5 cm a step off."""
    corrected = Carmen(str(data_dir / "corrected" / f"{name}-corrected.log.gz"))
    raw = Carmen(str(data_dir / "freiburg" / f"{name}.clf.gz"))
    assert raw.odometry is not None
    # The same scan has the same readings; the corrected files only lost digits of poses and times.
    place = {scan.round(2).tobytes(): i for i, scan in enumerate(np.nan_to_num(raw.ranges))}
    places = [place.get(scan.round(2).tobytes()) for scan in np.nan_to_num(corrected.ranges)]
    assert None not in places
    same = steps(raw.odometry[places])
    difference = inverse(same) @ steps(corrected.odometry)
    assert np.median(translation_norm(difference)) < 1e-4
    assert np.median(rotation_angle(difference)) < 1e-4


def test_intel_is_continuous_in_file_order_only(data_dir: Path) -> None:
    path = str(data_dir / "freiburg" / "intel.clf.gz")
    in_file, in_time = Carmen(path), Carmen(path, order="time")
    assert np.count_nonzero(np.diff(in_file.stamps) < 0) == 631
    assert translation_norm(steps(in_file.odometry)).max() < 0.23
    assert translation_norm(steps(in_time.odometry)).max() > 0.8
