"""Deskewing: points where they were seen from, and lower errors; said where it does not apply."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sweep_helpers import call

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.geometry import inverse, transform
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.datasets.deskewed import Deskewed, deskewed
from rbtm_bench.datasets.simulated import SimulatedPlace


def drive(place: str = "hall", skewed: bool = True) -> SimulatedPlace:
    return SimulatedPlace(
        place=place, scans=8, azimuths=512, range_noise=0.0, dropout=0.0, sway_deg=0.0,
        motion_distortion=skewed, odometry_noise_translation=0.0, odometry_noise_rotation_deg=0.0,
    )  # fmt: skip


class WithoutOdometry(SimulatedPlace):
    """The same, of which nothing but scans and truth is known."""

    has_odometry = False

    def __getitem__(self, index: int) -> Scan:
        return replace(super().__getitem__(index), odometry=None)


def exact(data: SimulatedPlace, index: int) -> Array:
    """The points of a scan as seen from where the sensor is at its stamp."""
    scan = data[index]
    assert scan.times is not None and scan.ground_truth is not None
    seen_from = data.poses(data.step * (index + scan.times / data.sensor.period))
    world = np.einsum("nij,nj->ni", seen_from[:, :3, :3], scan.points) + seen_from[:, :3, 3]
    return transform(inverse(scan.ground_truth), world)


def errors(data: SimulatedPlace, still: Deskewed, index: int) -> tuple[float, float]:
    """Median distance (m) from the exact points, before and after."""
    right = exact(data, index)
    before, after = data[index].points, still[index].points
    return tuple(float(np.median(np.linalg.norm(p - right, axis=1))) for p in (before, after))  # type: ignore[return-value]


@pytest.mark.parametrize("place", ["street", "hall", "office"])
def test_odometry_brings_points_to_the_stamp(place: str) -> None:
    data = drive(place)
    still = Deskewed(data)
    assert [str(r) for r in still.readings if r.what == "deskew"] == [
        "deskew: by the last motion of odometry, to the stamp "
        "(points have times within the scan; else deskew=)"
    ]
    for index in (0, 1, 4, 7):
        before, after = errors(data, still, index)
        assert before > 0.05 and after < 0.02 * before + 0.005, (index, before, after)
    assert still[3].times is None and len(still[3].points) == len(data[3].points)


def test_without_odometry_kiss_icp_finds_the_motion() -> None:
    plain = drive()
    data = WithoutOdometry(
        place="hall", scans=8, azimuths=512, range_noise=0.0, dropout=0.0, sway_deg=0.0,
        motion_distortion=True,
    )  # fmt: skip
    still = Deskewed(data)
    assert "last motion of KISS-ICP" in str(still.readings[-1])
    late = still[7].points  # before those in front of it: the order does not matter
    for index in (0, 1, 3, 5, 7):
        before, after = errors(plain, still, index)
        assert after < 0.5 * before, (index, before, after)
    again = Deskewed(data)
    for index in range(8):
        again[index]
    np.testing.assert_array_equal(again[7].points, late)
    assert still.fingerprint() != data.fingerprint()


def test_where_it_does_not_apply_that_is_said() -> None:
    at_once = Deskewed(drive(skewed=False))
    scan = at_once[2]
    assert scan.times is None or np.ptp(scan.times) > 0
    without = _Timeless(place="hall", scans=3, azimuths=64)
    still = Deskewed(without)
    assert "deskew: does not apply (no times within scans" in str(still.readings[-1])
    np.testing.assert_array_equal(still[2].points, without[2].points)
    assert still.fingerprint() == without.fingerprint()
    assert deskewed(without, False) is without
    with pytest.raises(ConfigError, match="deskew=true: for clouds"):
        deskewed(Corridor(scans=5), True)


class _Timeless(SimulatedPlace):
    def __getitem__(self, index: int) -> Scan:
        return replace(super().__getitem__(index), times=None)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["small_gicp_gicp", "kiss_icp_system"])
def test_the_error_is_lower_with_it(tmp_path: Path, backend: str) -> None:
    """Five m/s round a circle, swaying: what is seen first and last of a sweep is half a metre and
    six degrees apart."""
    words = [
        "dataset=simulated", "dataset.place=hall", "dataset.motion_distortion=true",
        "dataset.scans=16", "dataset.azimuths=512", "dataset.step=0.5", "dataset.sway_deg=4",
        "dataset.odometry_noise_translation=0.002", "dataset.odometry_noise_rotation_deg=0.01",
        f"backend={backend}", "selector=previous", "pictures=false", "deskew=false,true",
    ]  # fmt: skip
    code, text, error = call("compare", *words, f"out={tmp_path / 'out'}")
    assert code == 0, error
    ape = {}
    for run in (tmp_path / "out").glob("*/metrics.json"):
        record = json.loads((run.parent / "run.json").read_text())
        asked = any("deskew" in line for line in record["readings"])
        ape[asked] = json.loads(run.read_text())["ape_rmse_m"]
    assert ape[True] < 0.5 * ape[False], ape
    assert "deskew" in text
