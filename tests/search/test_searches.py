"""A search before a backend: where it starts, what it records, and what it shares."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from sweep_helpers import call, script

from rbtm_bench.backends.base import Placed
from rbtm_bench.backends.none import NoRegistration
from rbtm_bench.backends.plicp import PointToLineICP
from rbtm_bench.contract.scene import planar_scan
from rbtm_bench.core.geometry import inverse, rotation_angle, se2, transform, translation_norm, yaw
from rbtm_bench.core.types import Scan
from rbtm_bench.odometry import judge
from rbtm_bench.runs import assembly, settings
from rbtm_bench.search.base import SearchedBackend
from rbtm_bench.search.correlative import CorrelativeSearch
from rbtm_bench.search.none import NoSearch

START, T = se2(0.3, -0.2, 0.2), se2(0.7, 0.5, 0.5)
SMALL = ("dataset.scans=14", "selector=keyframe", "pictures=false", "metrics=default")


def test_a_local_method_starts_where_the_search_ends() -> None:
    plain = PointToLineICP()
    backend = CorrelativeSearch(translation=1.0, rotation_deg=40.0, peak_apart=0.4).before(plain)
    source = backend.prepare(planar_scan(START @ T, 1, 0.005))
    target = backend.prepare(planar_scan(START, 0, 0.005))
    far = inverse(T) @ plain.register(source, target, np.eye(4)).T_target_source
    assert translation_norm(far) > 0.1  # the guess is beyond its reach
    result = judge.register(backend, source, target, np.eye(4))
    off = inverse(T) @ result.T_target_source
    assert translation_norm(off) < 0.01 and rotation_angle(off) < 0.005
    assert result.search_score is not None and 0.7 < result.search_score <= 1.0
    assert result.search_peak_ratio is not None and 0.2 < result.search_peak_ratio < 0.95
    assert result.search_seconds is not None and 0.0 < result.search_seconds < result.seconds


def test_without_a_search_a_backend_is_left_alone() -> None:
    plain = PointToLineICP()
    assert NoSearch().before(plain) is plain
    guess = se2(0.1, 0.2, 0.3)
    start = NoSearch().start(None, None, guess)  # type: ignore[arg-type]
    assert start.T_target_source is guess and math.isnan(start.score)


@pytest.mark.parametrize(("distance", "reaches"), [(0.0, False), (3.0, True)])
def test_the_window_grows_with_the_motion(distance: float, reaches: bool) -> None:
    """The guess is 0.4 m short: within two standard deviations of 10 % of 3 m, not of none."""
    search = CorrelativeSearch(translation=0.05, rotation_deg=1.0)
    backend = PointToLineICP()
    target = backend.prepare(planar_scan(START, 0))
    moved = se2(-distance, 0.0, 0.0)
    shifted = planar_scan(START, 1)
    shifted.points[:, 0] += distance
    truth, guess = moved, moved @ se2(0.4, 0.0, 0.0)
    off = inverse(truth) @ search.start(backend.prepare(shifted), target, guess).T_target_source
    assert bool(translation_norm(off) < 0.1) == reaches


@pytest.mark.parametrize(
    ("settings", "is_right"),
    [
        ({}, False),
        ({"doubt": 0.75}, True),
        ({"doubt": 0.75, "wide_rotation_deg": 5.0}, False),  # the slip is further out
        ({"doubt": 0.2}, False),  # what there is scores more, so nothing is in doubt
        ({"doubt": 0.75, "wide_gain": 0.9}, False),
    ],
)
def test_a_slip_of_the_wheels_is_met_where_the_window_is_in_doubt(
    settings: dict[str, float], is_right: bool
) -> None:
    """The wheels say 3 deg, the scan turned by 20, as scan 3591 of a log did."""
    truth, guess = se2(0.05, 0.0, math.radians(-20.0)), se2(0.05, 0.0, math.radians(-3.0))
    backend = PointToLineICP()
    target = backend.prepare(planar_scan(START, 0, 0.005))
    source = backend.prepare(planar_scan(START @ truth, 1, 0.005))
    start = CorrelativeSearch(**settings).start(source, target, guess)
    off = inverse(truth) @ start.T_target_source
    assert (float(rotation_angle(off)) < 0.02) == is_right
    assert (start.score > 0.75) == is_right


@pytest.mark.parametrize(("min_gain", "leaves"), [(0.0, True), (0.5, False)])
def test_the_guess_is_left_for_a_better_score_only(min_gain: float, leaves: bool) -> None:
    search, backend = CorrelativeSearch(min_gain=min_gain), PointToLineICP()
    source, target = (backend.prepare(planar_scan(START, i)) for i in (1, 0))
    guess = se2(0.07, 0.04, 0.0)
    start = search.start(source, target, guess)
    assert (start.T_target_source is not guess) == leaves
    assert (start.score > 0.9) == leaves


def test_nothing_to_be_seen_keeps_the_guess() -> None:
    search, backend = CorrelativeSearch(), PointToLineICP()
    target = backend.prepare(planar_scan(START, 0))
    guess = se2(500.0, 0.0, 0.1)
    start = search.start(target, target, guess)
    assert start.score == 0.0 and start.T_target_source is guess
    assert float(yaw(start.T_target_source)) == pytest.approx(0.1)


def test_runs_differ_by_their_search_and_older_ones_have_none() -> None:
    words = ["selector=keyframe", "backend=plicp", "dataset=corridor"]
    plain = settings.compose_settings(words)
    one = settings.compose_settings([*words, "search=correlative"])
    other = settings.compose_settings([*words, "search=correlative", "search.translation=0.2"])
    assert len({s.identity.run for s in (plain, one, other)}) == 3
    assert "search" not in plain.identity.choices  # as runs that do not name the group
    nodes = [assembly.backend_node(s.config) for s in (plain, one, other)]
    assert nodes[0] == plain.config["backend"]  # pairs known before this group are still known
    assert nodes[0] != nodes[1] != nodes[2]
    assert isinstance(assembly.build_backend(one.config), SearchedBackend)


def test_a_run_says_what_its_search_cost_and_shares_its_pairs(tmp_path: Path) -> None:
    words = ("compare", "backend=plicp", "guess=identity", "search=none,correlative", *SMALL)
    for out in ("first", "again"):
        folders = (f"out='{tmp_path / out}'", f"pairs.folder='{tmp_path / 'pairs'}'")
        code, _, error = call(*words, *folders)
        assert code == 0, error
    tables = {
        p.parent.name: pd.read_parquet(p) for p in (tmp_path / "again").rglob("steps.parquet")
    }
    assert len(tables) == 2
    (searched,) = (t for name, t in tables.items() if "correlative" in name)
    (plain,) = (t for name, t in tables.items() if "correlative" not in name)
    assert plain["search_score"].isna().all() and plain["search_seconds"].isna().all()
    done = searched[searched["status"] == "registered"]
    assert len(done) and done["reused"].all()  # the second time out of the store
    assert done["search_score"].between(0.5, 1.0).all()
    assert (done["search_seconds"] < done["t_register_s"]).all()
    assert (searched["fitness"].to_numpy()[1:] != plain["fitness"].to_numpy()[1:]).any()


def test_clouds_in_space_are_refused_in_one_line() -> None:
    words = ("dataset=simulated", "dataset.scans=3", "search=correlative", "backend=none")
    code, _, error = call("run", *words, "selector=previous")
    assert code == 2 and "search=correlative is for 2d only; this data set is 3d" in error


def test_search_then_plicp_needs_no_guess() -> None:
    assert script("bench_search").share_found(12, seed=7) >= 11 / 12


def test_a_target_seen_from_elsewhere_is_searched_as_it_was_built() -> None:
    """The window is that of the motion between the scans, not of the place in a map."""
    truth = se2(0.3, -0.1, 0.1)
    backend, search = NoRegistration(), CorrelativeSearch(0.3, 5.0, sigmas=2.0)
    points = np.array([[x, 2.0, 0.0] for x in np.linspace(-2, 3, 80)])
    points = np.concatenate([points, [[3.0, y, 0.0] for y in np.linspace(-1, 2, 50)]])
    target = backend.prepare(Scan(0, 0.0, points, planar=True))
    source = backend.prepare(Scan(1, 0.1, transform(inverse(truth), points), planar=True))
    plain = search.start(source, target, truth @ se2(0.2, 0.1, 0.03))
    T_map_target = se2(40.0, -25.0, 1.3)
    built = backend.prepare(Scan(0, 0.0, transform(T_map_target, points), planar=True))
    placed = search.start(source, Placed(built, T_map_target), truth @ se2(0.2, 0.1, 0.03))
    off = inverse(plain.T_target_source) @ placed.T_target_source
    assert np.abs(off - np.eye(4)).max() < 0.06  # another grid of cells, the same place
    assert search.before(backend).join([(target, np.eye(4))]).planar
