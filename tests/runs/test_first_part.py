"""What follows from the data's first part: thresholds and distances, by hand and in a run."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.geometry import se2
from rbtm_bench.core.types import Node, Scan
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.pairs.shared import SharedDataset
from rbtm_bench.report import screen
from rbtm_bench.runs import assembly, experiment
from rbtm_bench.runs.first_part import (
    UNDECIDED,
    Pilot,
    Span,
    deciding,
    distances,
    filled,
    median_range,
    scans_of,
    threshold,
)
from rbtm_bench.runs.settings import compose_settings
from rbtm_bench.runs.stored import read_run
from rbtm_bench.runs.workbench import Workbench
from rbtm_bench.selection.keyframe import Keyframe
from rbtm_bench.selection.rbtm import Rbtm

NAN = float("nan")


class Rings(Dataset):
    """Scan i: points 1 + i, 2 + i and 9 + i m away."""

    planar = True

    def __init__(self, count: int) -> None:
        self.count = count

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> Scan:
        ranges = index + np.array([1.0, 2.0, 9.0])
        return Scan(index, 0.1 * index, ranges[:, None] * [[0.6, 0.8, 0.0]], planar=True)

    def fingerprint(self) -> str:
        return f"rings {self.count}"


def test_a_tenth_of_the_scans_between_20_and_300() -> None:
    assert [scans_of(n) for n in (5, 20, 199, 250, 2000, 7374)] == [5, 20, 20, 25, 200, 300]


def test_the_median_range_is_of_the_first_part() -> None:
    """Medians 2, 3, ... 21 m of 20 scans, whatever follows."""
    assert median_range(Rings(20)) == median_range(Rings(200)) == pytest.approx(11.5)


def test_distances_are_relative_where_none_is_given() -> None:
    node = {"distance": None, "distance_relative": 0.1}
    assert distances({"selector": node}, Rings(20)) == {"selector.distance": 1.15}
    assert distances({"selector": {**node, "distance": 0.5}}, Rings(20)) == {}
    of_window = {"keyframe_distance": None, "keyframe_distance_relative": 0.2}
    assert distances({"selector": {**of_window, "content": "scans"}}, Rings(20)) == {}
    kept = {"selector": {**of_window, "content": "keyframes"}}
    assert distances(kept, Rings(20)) == {"selector.keyframe_distance": 2.3}


def test_the_highest_threshold_that_decides_nearly_as_many_as_any() -> None:
    """Ranges [oldest, highest) of ten scans. Five hold between .5 and .6; four, four fifths of
    them, still between .6 and .7; above only the three of .4 and .8."""
    spans = [Span(0.4, 0.8)] * 3 + [Span(0.5, 0.7), Span(0.5, 0.6)]
    spans += [Span(0.9, 0.3)] * 4 + [Span(NAN, -np.inf)]
    assert deciding(spans) == (0.65, 0.4)
    assert deciding(spans[::-1]) == (0.65, 0.4), "in any order"


def test_an_undefined_oldest_never_passes() -> None:
    assert deciding([Span(NAN, 0.6)] * 2 + [Span(0.2, 0.6)]) == (0.4, 1.0)


@pytest.mark.parametrize("spans", [[], [Span(1.0, 1.0)] * 9, [Span(NAN, -np.inf)]])
def test_where_nothing_decides_the_usual_stays(spans: list[Span]) -> None:
    assert deciding(spans) == (UNDECIDED, 0.0)


def test_a_window_that_saw_no_motion_says_nothing() -> None:
    """A window of three: full with scan 2. The robot stands, moves by 0.2 m, turns by 2 deg."""
    pilot = Pilot(Rbtm(window=4, threshold="auto"), moved_m=0.1)
    window = pilot.window()
    poses = [(0, 0), (0, 0), (0, 0), (0.2, 0), (0.2, 0), (0.2, 0), (0.2, np.radians(2)), (0.2, 0)]
    for scan, (x, theta) in enumerate(poses):
        if scan:
            scores = np.linspace(0.1 * scan, 0.9, len(window))
            assert pilot.choose(scan, window, scores).candidates[0].model == scan - 1
        window.push(Node(scan, 0.0, se2(x, 0, theta)))
    assert [round(span.oldest, 1) for span in pilot.spans] == [0.4, 0.5, 0.7]
    assert {span.highest for span in pilot.spans} == {0.9}


def test_what_is_not_determined_does_not_run() -> None:
    with pytest.raises(ConfigError, match="threshold=auto"):
        Rbtm(threshold="auto").select(3, np.arange(3), np.ones(3))
    for make in (lambda: Keyframe(None), lambda: Rbtm(content="keyframes", keyframe_distance=None)):
        with pytest.raises(ConfigError, match="keyframe distance"):
            make()


SCANS = ["dataset=corridor", "dataset.scans=61", "backend=plicp", "pictures=false"]


@pytest.mark.parametrize("shares", [False, True])
def test_a_run_says_what_it_determined(shares: bool, tmp_path: Path) -> None:
    """And the number that it says gives the same run."""
    words = [*SCANS, "selector=rbtm", "selector.window=8"]
    settings = compose_settings([*words, "selector.threshold=auto"])
    bench = Workbench() if shares else None
    record = experiment.run(settings, tmp_path / "auto", bench=bench)
    value = record["determined"]["selector.threshold"]
    assert 0.5 < value < 1.0 and value == round(value, 4)
    assert f"selector.threshold={value:g} decides" in record["readings"][-1]
    metrics = json.loads((tmp_path / "auto" / "metrics.json").read_text())
    assert metrics["decided"] > 0.5
    stored = read_run(tmp_path / "auto")
    assert stored.section("selector")["threshold"] == value
    assert stored.config["selector"]["threshold"] == "auto"
    given = compose_settings([*words, f"selector.threshold={value}"])
    again = experiment.run(given, tmp_path / "given")
    assert again["trajectory_sha256"] == record["trajectory_sha256"]
    assert again["determined"] == {}


class Cut(Dataset):
    """The first ``count`` scans of another data set."""

    def __init__(self, of: Dataset, count: int) -> None:
        self.of, self.count, self.planar, self.has_beams = of, count, of.planar, of.has_beams

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> Scan:
        return self.of[index]

    def fingerprint(self) -> str:
        return f"{self.count} of {self.of.fingerprint()}"


def test_the_end_of_the_data_changes_no_threshold() -> None:
    """20 windows in motion say it of 60 scans as of 90; a method is given no truth."""
    settings = compose_settings([*SCANS[:1], "dataset.scans=91", "backend=plicp", "selector=rbtm"])
    corridor = assembly.build(settings.config["dataset"])
    values = set()
    for count in (60, 90):
        method = assembly.method_of(filled(settings.config, {"selector.threshold": "auto"}))
        values.add(threshold(SharedDataset(Cut(corridor, count), 0.0, None), method))
    assert len(values) == 1, values
    assert "20 full windows in motion among the first 29 scans" in values.pop()[1]


def test_a_replicate_moves_what_was_determined(tmp_path: Path) -> None:
    words = [*SCANS, "selector=rbtm", "selector.threshold=auto", "replicate=1"]
    record = experiment.run(compose_settings(words), tmp_path / "run")
    value = record["determined"]["selector.threshold"]
    moved = record["replicate"]["settings"]["selector.threshold"]
    assert 0.0 < abs(moved - value) <= 0.01


def test_a_keyframe_relative_to_the_scene(tmp_path: Path) -> None:
    words = [*SCANS, "selector=keyframe", "selector.distance=null"]
    record = experiment.run(compose_settings(words), tmp_path / "run")
    ranges = record["determined"]["selector.distance"] / 0.1
    parts = assembly.instantiate(compose_settings(words))
    assert ranges == pytest.approx(median_range(parts.dataset), rel=0.01)
    assert read_run(tmp_path / "run").section("selector")["distance"] == pytest.approx(0.1 * ranges)


def test_the_summary_of_a_run_says_it(tmp_path: Path) -> None:
    words = [*SCANS, "selector=rbtm", "selector.threshold=auto"]
    record = experiment.run(compose_settings(words), tmp_path / "run")
    (line,) = [one for one in screen.of_run(tmp_path / "run").splitlines() if "decides" in one]
    assert line.strip() == record["readings"][-1]
