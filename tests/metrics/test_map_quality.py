"""MapQuality against values worked out by hand, and what it rewards for wrong reasons."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from rbtm_bench.core.columns import REFERENCES
from rbtm_bench.core.errors import DataError
from rbtm_bench.core.geometry import se2, yaw
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.metrics.base import Metric, evaluated
from rbtm_bench.metrics.map_quality import MapQuality
from rbtm_bench.runs import experiment
from rbtm_bench.runs.settings import compose_settings

OF_THE_MAP = ("map_entropy_nat", "map_variance_mm2", "map_cells", "map_supported")
LOG_2_PI_E = np.log(2 * np.pi * np.e)


class Clouds(Dataset):
    """Scans made of given points; counts how often each is read."""

    has_ground_truth = True

    def __init__(self, clouds: list[Any], planar: bool = True) -> None:
        self.clouds = [np.asarray(cloud, dtype=float).reshape(-1, 3) for cloud in clouds]
        self.planar = planar
        self.read: list[int] = []

    def __len__(self) -> int:
        return len(self.clouds)

    def __getitem__(self, index: int) -> Scan:
        self.read.append(index)
        return Scan(index, 0.1 * index, self.clouds[index], self.planar)

    def fingerprint(self) -> str:
        return "by hand"


def path(T: Any) -> Trajectory:
    return Trajectory(0.1 * np.arange(len(T)), np.asarray(T, dtype=float))


def still(count: int) -> Array:
    return np.tile(np.eye(4), (count, 1, 1))


def driven(**settings: Any) -> tuple[Corridor, Trajectory]:
    """A simulated drive and its truth."""
    corridor = Corridor(**settings)
    return corridor, path(corridor.ground_truth)


def numbers(values: Any, end: str = "") -> list[Any]:
    return [values[key + end] for key in OF_THE_MAP]


# --- by hand


WALL = [(x, y, 0) for x in (0.9, 1.1) for y in (-0.01, 0.01)]
"""Variances of 0.1^2 m^2 along and 0.01^2 m^2 across."""


def test_in_the_plane_by_hand() -> None:
    """The estimate moves the second scan by 2 cm across the wall: 2e-4 m^2 instead of 1e-4."""
    metric = MapQuality(neighbours=8, cell=0.1)
    values = metric.evaluate_scans(
        path([np.eye(4), se2(0, 0.02, 0)]), path(still(2)), Clouds([WALL, WALL])
    )
    assert list(values) == list(metric.columns)
    entropy = LOG_2_PI_E + 0.5 * np.log(0.01 * 2e-4)
    assert numbers(values) == pytest.approx([entropy, 200.0, 4, 1.0])
    entropy = LOG_2_PI_E + 0.5 * np.log(0.01 * 1e-4)
    assert numbers(values, "_truth") == pytest.approx([entropy, 100.0, 4, 1.0])
    assert numbers(values, "_still") == numbers(values, "_truth")
    assert type(values["map_cells"]) is int


def test_in_space_by_hand() -> None:
    """Two layers of a box with variances of 0.1^2, 0.05^2 and 0.03^2 m^2."""
    box = [(x, y, z) for x in (0.9, 1.1) for y in (-0.05, 0.05) for z in (-0.03, 0.03)]
    values = MapQuality(neighbours=16, cell=0.04).evaluate_scans(
        path(still(2)), None, Clouds([box, box], planar=False)
    )
    entropy = 1.5 * LOG_2_PI_E + np.log(0.1 * 0.05 * 0.03)
    assert numbers(values) == pytest.approx([entropy, 900.0, 8, 1.0])
    assert numbers(values, "_truth") == [None] * 4


def test_height_does_not_count_in_the_plane() -> None:
    flat = MapQuality(neighbours=4).evaluate_scans(path(still(2)), None, Clouds([WALL, WALL]))
    lifted = np.array([np.eye(4), np.eye(4)])
    lifted[1, 2, 3] = 0.5
    values = MapQuality(neighbours=4).evaluate_scans(path(lifted), None, Clouds([WALL, WALL]))
    assert numbers(values) == numbers(flat)


def test_no_map_is_thinner_than_a_millimetre() -> None:
    line = [(x, 0, 0) for x in np.linspace(0.9, 1.1, 10)]
    values = MapQuality(neighbours=4).evaluate_scans(path(still(2)), None, Clouds([line, line]))
    assert values["map_variance_mm2"] == pytest.approx(1.0)
    variance = np.var(np.linspace(0.9, 1.1, 10))
    expected = LOG_2_PI_E + 0.5 * np.log(1e-6 * variance)
    assert values["map_entropy_nat"] == pytest.approx(expected)


def test_lonely_points_are_left_out_and_counted() -> None:
    alone = [*WALL, (9, 9, 0)]
    values = MapQuality(neighbours=8).evaluate_scans(path(still(2)), None, Clouds([WALL, alone]))
    assert values["map_supported"] == pytest.approx(8 / 9)
    assert values["map_variance_mm2"] == pytest.approx(100.0)
    values = MapQuality(neighbours=9).evaluate_scans(path(still(2)), None, Clouds([WALL, alone]))
    assert numbers(values) == [None, None, 5, 0.0]  # no number out of nothing


def test_radius_is_wider_for_clouds() -> None:
    """Points 0.5 m apart are neighbours in space, and not in the plane."""
    row = [(x, 0, 0) for x in (1.0, 1.5, 2.0)]
    for planar, supported in ((True, 0.0), (False, 1.0)):
        data = Clouds([row, row], planar)
        values = MapQuality(neighbours=4).evaluate_scans(path(still(2)), None, data)
        assert values["map_supported"] == supported
    values = MapQuality(neighbours=4, radius=0.6).evaluate_scans(
        path(still(2)), None, Clouds([row, row])
    )
    assert values["map_supported"] == 1.0


# --- the same scans and points for every method


def test_scans_and_points_are_spread_evenly_and_bounded() -> None:
    clouds = [[(x, i, 0) for x in range(10)] for i in range(9)]
    data = Clouds(clouds)
    values = MapQuality(scans=3, points=6, cell=1.0).evaluate_scans(path(still(9)), None, data)
    assert data.read == [0, 4, 8]  # each once, for all maps together
    assert values["map_cells"] == 3 * 2  # the first and the last point of each


def test_centres_are_spread_evenly() -> None:
    alone = [*WALL, (9, 9, 0)]  # every fifth point is lonely, the last among them
    values = MapQuality(neighbours=8, centres=2).evaluate_scans(
        path(still(2)), None, Clouds([alone, alone])
    )
    assert values["map_supported"] == 0.5


def test_what_is_measured_does_not_depend_on_the_estimate() -> None:
    corridor, truth = driven(scans=20)
    metric = MapQuality(scans=7, points=700)
    stuck = metric.evaluate_scans(path(still(20)), truth, corridor)
    exact = metric.evaluate_scans(truth, truth, corridor)
    for end in REFERENCES:
        assert numbers(stuck, end) == numbers(exact, end)
    assert numbers(stuck) == numbers(stuck, "_still")
    assert numbers(exact) == numbers(exact, "_truth") != numbers(stuck)


def test_scans_without_a_truth_are_left_out_of_every_map() -> None:
    corridor, truth = driven(scans=20)
    part = truth.T_world_scan.copy()
    part[:5] = part[15:] = np.nan
    values = MapQuality().evaluate_scans(truth, path(part), corridor)
    assert numbers(values) == numbers(values, "_truth")
    shorter = Clouds([corridor[i].points for i in range(5, 15)])
    middle = path(part[5:15])
    assert values == MapQuality().evaluate_scans(middle, middle, shorter)


def test_a_scan_without_a_pose_leaves_no_map() -> None:
    corridor, truth = driven(scans=12)
    lost = path(truth.T_world_scan.copy())
    lost.T_world_scan[3] = np.nan
    values = MapQuality().evaluate_scans(lost, truth, corridor)
    assert numbers(values) == [None] * 4
    whole = MapQuality().evaluate_scans(truth, truth, corridor)
    assert numbers(values, "_truth") == numbers(whole, "_truth")


def test_the_world_frame_does_not_matter_and_bits_repeat() -> None:
    corridor, truth = driven(scans=15, environment="cluttered")
    before = truth.T_world_scan.copy()
    first = MapQuality().evaluate_scans(truth, truth, corridor)
    assert first == MapQuality().evaluate_scans(truth, truth, corridor)
    moved = path(se2(30, -7, 2.0) @ truth.T_world_scan)
    after = MapQuality().evaluate_scans(moved, truth, corridor)
    assert numbers(after) == pytest.approx(numbers(first), rel=1e-6)
    assert np.array_equal(truth.T_world_scan, before)


@pytest.mark.parametrize("clouds", [[], [WALL], [[], []]])
def test_nothing_to_measure(clouds: list[Any]) -> None:
    values = MapQuality().evaluate_scans(path(still(len(clouds))), None, Clouds(clouds))
    assert set(values.values()) == {None} and list(values) == list(MapQuality.columns)


def test_poses_and_scans_must_be_as_many() -> None:
    with pytest.raises(DataError, match="3 poses for 2 scans"):
        MapQuality().evaluate_scans(path(still(3)), None, Clouds([WALL, WALL]))


# --- what it tells, and what it rewards


@pytest.mark.parametrize("place", ["paper", "cluttered", "l_turn"])
def test_where_there_is_structure_the_truth_is_crisper_than_no_motion(place: str) -> None:
    corridor, truth = driven(environment=place, scans=61)
    values = MapQuality().evaluate_scans(truth, truth, corridor)
    for key in OF_THE_MAP[:3]:
        assert values[f"{key}_truth"] < values[f"{key}_still"]


def between(G: Array, E: Array, share: float) -> Array:
    """Planar poses (N, 4, 4) on the way from those of G to those of E."""
    x, y, turn = (
        (1 - share) * g + share * e for g, e in zip(coordinates(G), coordinates(E), strict=True)
    )
    return np.stack([se2(*pose) for pose in zip(x, y, turn, strict=True)])


def coordinates(T: Array) -> tuple[Array, Array, Array]:
    return T[:, 0, 3], T[:, 1, 3], np.asarray(yaw(T))


@pytest.mark.parametrize("seed", range(3))
def test_drift_makes_a_worse_map(seed: int) -> None:
    """The truth, half of the error of wheel odometry, and all of it: ever thicker walls. The count
    of cells tells only large errors: in the truth every wall lies on a border of two cells."""
    corridor, truth = driven(
        environment="cluttered", scans=61, odometry_noise_rotation_deg=0.3, seed=seed
    )
    metric, exact = MapQuality(centres=2000), truth.T_world_scan
    values = []
    for share in (0.0, 0.5, 1.0):
        estimate = path(between(exact, corridor.odometry, share))
        values.append(metric.evaluate_scans(estimate, truth, corridor))
    for key in ("map_entropy_nat", "map_variance_mm2"):
        assert values[0][key] < values[1][key] < values[2][key]
    assert values[0]["map_cells"] < values[2]["map_cells"]


def test_in_a_bare_corridor_no_motion_beats_the_truth() -> None:
    """Every scan looks the same, so a map that never moved is as crisp, and shorter."""
    for seed in range(3):
        corridor, truth = driven(environment="bare", path_length=1.8, seed=seed)
        values = MapQuality(centres=1000).evaluate_scans(truth, truth, corridor)
        assert 480 < values["map_cells_truth"] < 520
        assert 330 < values["map_cells_still"] < 380
        assert values["map_entropy_nat_still"] < values["map_entropy_nat_truth"]


def test_a_map_that_flew_apart_has_less_entropy_than_the_truth() -> None:
    """Each scan by itself is crisp; only the count of cells, and of neighbours, tells."""
    corridor, truth = driven(scans=61)
    apart = path([se2(100.0 * i, 0, 0) for i in range(61)])
    values = MapQuality().evaluate_scans(apart, truth, corridor)
    assert values["map_entropy_nat"] < values["map_entropy_nat_truth"]
    assert values["map_cells"] > 20 * values["map_cells_truth"]
    assert values["map_supported"] < values["map_supported_truth"] == 1.0


# --- as part of a run


class PoseCount(Metric):
    """A metric as others write them: it knows nothing of scans."""

    columns: ClassVar[dict[str, str]] = {"poses": "count; poses; own"}

    def evaluate(self, estimate: Any, truth: Any, relations: Any) -> Any:
        return {"poses": len(estimate)}


class Duck:
    """Not even derived from ours."""

    columns: ClassVar[dict[str, str]] = {"poses": "count; poses; own"}
    evaluate = PoseCount.evaluate


@pytest.mark.parametrize("metric", [PoseCount(), Duck()])
def test_metrics_without_scans_work_as_ever(metric: Any) -> None:
    data = Clouds([WALL, WALL])
    assert evaluated(metric, path(still(2)), None, data) == {"poses": 2}
    assert data.read == []


def test_a_map_metric_without_scans_knows_nothing() -> None:
    corridor, truth = driven(scans=4)
    assert set(MapQuality().evaluate(truth, truth).values()) == {None}
    assert evaluated(MapQuality(), truth, truth, corridor)["map_cells"] is not None


@pytest.mark.parametrize("backend", ["none", "kiss_icp_system"])
def test_metrics_maps_adds_them_to_a_run(backend: str, tmp_path: Path) -> None:
    words = [f"backend={backend}", "dataset.scans=8", "pin=false", "pictures=false"]
    if backend == "none":
        words.append("selector=previous")
    settings = compose_settings([*words, "metrics=maps"])
    experiment.run(settings, tmp_path / "run")
    values = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert set(MapQuality.columns) < set(values) and "ape_rmse_m" in values
    assert values["map_cells"] and values["map_cells_truth"] and values["map_cells_still"]
    if backend == "none":  # it never moves
        assert numbers(values) == numbers(values, "_still")
    default = compose_settings(words).config["metrics"]
    assert default.items() < settings.config["metrics"].items()
    assert set(settings.config["metrics"]) - set(default) == {"map_quality"}
