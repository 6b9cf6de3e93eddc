"""The controls that a grid with rbtm gets by itself: which, how many, and what they are matched
to."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.engine import one_run
from rbtm_bench.runs import controls
from rbtm_bench.runs.controls import ROTATIONS, mean_hop, plan
from rbtm_bench.runs.experiment import run
from rbtm_bench.runs.grid import Point, make_points
from rbtm_bench.runs.settings import compose_settings


def points(*words: str) -> list[Point]:
    return make_points(list(words))[0]


def added(*words: str) -> Counter[str]:
    """How many controls of every selector a grid gets."""
    every = plan(points(*words)).planned
    assert len({point.name for point in every}) == len(every)
    return Counter(point.settings.choices["selector"] for point in every)


ALL = {"previous": 1, "oldest": 1, "keyframe": 1, "fixed_gap": 1, "shifted_gap": ROTATIONS}


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("", ALL),
        ("selector=rbtm_verified", ALL),
        ("selector=rbtm,previous", ALL | {"previous": 0}),
        ("selector=rbtm,oldest,keyframe", ALL | {"oldest": 0}),  # at another window it is added
        ("selector.threshold=0.6,0.7,0.8", ALL),
        ("similarity=overlap,curvature_circular selector.threshold=0.6,0.7", ALL),
        ("selector.window=8,16", ALL | {"oldest": 2, "keyframe": 2, "fixed_gap": 2}),
        ("backend=open3d_p2p,plicp", {key: 2 * value for key, value in ALL.items()}),
        ("backend=open3d_p2p,none", ALL),
        ("backend=none", {}),
        ("backend=kiss_icp_system,open3d_p2p", ALL),
        ("selector=previous,keyframe,best,oracle", {}),
        ("controls=none", {}),
        # every seed and replicate has its own, but for rotations, which are of one run
        ("seed=0,1,2", {key: 3 for key in ALL} | {"shifted_gap": ROTATIONS}),
        ("replicates=2", {key: 3 for key in ALL} | {"shifted_gap": ROTATIONS}),
        # a window of one node cannot be a map
        ("target=local_map", ALL | {"previous": 0, "keyframe": 0}),
        (
            "target=local_map selector.content=keyframes",
            {"oldest": 1, "shifted_gap": ROTATIONS},
        ),
    ],
)
def test_what_is_added(words: str, expected: dict[str, int]) -> None:
    assert added(*words.split()) == Counter(expected)


def test_a_control_differs_from_its_run_in_the_selector_alone() -> None:
    words = [
        "selector=rbtm_verified",
        "selector.window=7",
        "backend=plicp",
        "seed=4",
        "replicate=2",
    ]
    words += ["selector.content=keyframes", "selector.keyframe_distance=0.4", "guess=odometry"]
    words += ["selector.keyframe_distance_relative=0.2", "selector.window_m=5"]
    (ours,) = points(*words)
    for point in plan([ours]).planned:
        theirs = point.settings
        same = ours.settings.identity.without("selector", "similarity")
        assert theirs.identity.without("selector", "similarity") == same
        assert theirs.choices["check"] == "consistent" and theirs.control["of"] == ours.name
        if theirs.choices["selector"] in ("oldest", "shifted_gap"):
            assert theirs.config["selector"]["window"] == 7
            assert theirs.config["selector"]["keyframe_distance"] == 0.4
            assert theirs.config["selector"]["keyframe_distance_relative"] == 0.2
            assert theirs.config["selector"]["window_m"] == 5
        typed = compose_settings([w for w in theirs.overrides if "gaps" not in w])
        if theirs.choices["selector"] != "shifted_gap":
            assert typed.identity.run == theirs.identity.run, "what it was is what one would type"


def test_a_missing_control_is_said() -> None:
    notes = plan(points("target=local_map")).notes
    expected = "remembers 1 past scan: expected at least the 2 that target=local_map needs"
    assert notes == [f"no control {name}: it {expected}" for name in ("previous", "keyframe")]


@pytest.mark.parametrize("selector", ["previous", "keyframe", "rbtm selector.window=2"])
def test_a_target_that_a_window_cannot_fill_is_refused_before_anything_runs(selector: str) -> None:
    grid = points("target=local_map", *f"selector={selector}".split(), "dataset.scans=5")
    with pytest.raises(ConfigError, match="remembers 1 past scan: expected at least the 2 that"):
        one_run.check_data(grid)
    one_run.check_data(points("target=local_map", "selector.window=3", "dataset.scans=5"))
    one_run.check_data(points("target=single", "selector=previous", "dataset.scans=5"))


SMALL = ("dataset.scans=30", "dataset.beams=91", "pin=false", "pictures=false")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A grid's runs of rbtm at two thresholds."""
    folder = tmp_path_factory.mktemp("finished")
    for point in points(*SMALL, "selector.threshold=0.7,0.95"):
        run(point.settings, folder / point.name)
    return folder


def test_what_is_matched_to_the_best_run(finished: Path) -> None:
    grid = points(*SMALL, "selector.threshold=0.7,0.95")
    made = controls.resolve(plan(grid).matched, [*grid, *plan(grid).plain], finished)
    assert len(made.points) == 2 + ROTATIONS and not made.idle
    keyframe, fixed, *rotated = (point.settings for point in made.points)
    of = {s.control["of"] for s in (keyframe, fixed, *rotated)}
    errors = {p.name: _final(finished / p.name) for p in grid}
    (best,) = of
    assert errors[best] == min(errors.values()) < max(errors.values())
    gaps = controls.sequence(finished / best)
    assert fixed.config["selector"]["gap"] == pytest.approx(np.mean(gaps), abs=0.005)
    hop = mean_hop(finished / best)
    assert keyframe.config["selector"]["distance"] == pytest.approx(hop, rel=0.005)
    offsets = [s.config["selector"]["offset"] for s in rotated]
    assert len(set(offsets)) == ROTATIONS and 1 <= min(offsets) <= max(offsets) < len(gaps)
    assert {s.config["selector"]["gaps_from"] for s in rotated} == {str(finished / best)}
    assert len({s.identity.method for s in rotated}) == 1, "one row of a table"
    assert len({s.identity.run for s in rotated}) == ROTATIONS
    again = controls.resolve(plan(grid).matched, [*grid, *plan(grid).plain], finished)
    assert [p.settings.config for p in again.points] == [p.settings.config for p in made.points]


def test_a_control_that_is_there_already_is_not_made_twice(finished: Path) -> None:
    grid = points(*SMALL, "selector.threshold=0.7,0.95")
    fixed = controls.resolve(plan(grid).matched, grid, finished).points[1]
    typed = f"selector.gap={fixed.settings.config['selector']['gap']}"
    more = [*grid, *points(*SMALL, "selector=fixed_gap", typed)]
    made = controls.resolve(plan(more).matched, more, finished)
    assert list(made.idle.values()) == [f"it is the same as {more[-1].name}"]


def test_without_a_finished_run_nothing_is_matched(tmp_path: Path) -> None:
    grid = points(*SMALL)
    made = controls.resolve(plan(grid).matched, grid, tmp_path)
    assert not made.points and not made.idle


def test_equal_gaps_have_no_rotations(tmp_path: Path) -> None:
    """A threshold that never passes is ``previous``: all gaps are 1."""
    (point,) = grid = points(*SMALL, "selector.threshold=1.0")
    run(point.settings, tmp_path / point.name)
    made = controls.resolve(plan(grid).matched, grid, tmp_path)
    assert [p.settings.choices["selector"] for p in made.points] == ["keyframe", "fixed_gap"]
    assert made.points[1].settings.config["selector"]["gap"] == 1
    assert set(made.idle.values()) == {"all gaps of rbtm are equal: so are their rotations"}
    assert len(made.idle) == ROTATIONS


def test_the_mean_hop_is_between_a_scan_and_its_model(tmp_path: Path) -> None:
    """With the true poses as poses: 30 scans along 1.8 m at steps of 62 mm, gap 2."""
    words = [*SMALL, "selector=fixed_gap", "selector.gap=2", "dataset.range_noise=0"]
    run(compose_settings(words), tmp_path)
    (tmp_path / "trajectory.tum").write_bytes((tmp_path / "ground_truth.tum").read_bytes())
    step = 1.8 / 29
    assert mean_hop(tmp_path) == pytest.approx((28 * 2 * step + step) / 29, rel=1e-6)


def _final(folder: Path) -> float:
    value = controls.read_run(folder).metrics["final_translation_error_mm"]
    assert isinstance(value, float)
    return value
