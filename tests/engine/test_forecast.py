"""How many registrations a grid may ask for: a bound that holds, or a reason why there is none."""

from __future__ import annotations

from pathlib import Path

import pytest
from sweep_helpers import SMALL, call, record_of

from rbtm_bench.engine import forecast
from rbtm_bench.engine.hydra_sweep import MOST_COMPOSED, SweepPlan
from rbtm_bench.report import screen
from rbtm_bench.runs.grid import make_points

GRID = (
    "backend=open3d_p2p,none",
    "selector=rbtm,previous",
    "selector.window=4,7",
    "guess=identity",
)


def most(*words: str, scans: int = 12) -> int | str:
    points, _ = make_points([*words, f"dataset.scans={scans}"])
    return forecast.check(points, points)


def by_hand(scans: int, window: int) -> int:
    """Pairs of a scan and one of so many before it; a selector's window counts the new scan too."""
    return sum(min(scan, window) for scan in range(scans))


def test_ways_that_share_pairs_count_once() -> None:
    assert most("selector=previous", "guess=identity") == 11
    assert most(*GRID) == 2 * by_hand(12, 6)
    assert most(*GRID, "similarity=overlap,curvature_circular") == 2 * by_hand(12, 6)
    assert most(*GRID, "seed=0,1", "dataset.range_noise=0.02") == 4 * by_hand(12, 6)
    assert most(*GRID[1:], "selector.window=30") == by_hand(12, 11)
    assert most("selector=previous", "guess=chain") == 11 + 11


def test_windows_that_differ_may_hold_any_scan() -> None:
    every = by_hand(12, 11)
    assert most("selector=keyframe", "guess=identity") == 11  # of one there is one a scan
    assert most("selector=previous,keyframe", "selector.distance=0.3,0.4", GRID[-1]) == 11 + 2 * 11
    assert most(*GRID, "selector.distance=0.3", "selector=oldest,keyframe") == 2 * (
        by_hand(12, 6) + 11
    )
    assert most("selector=oldest", "selector.content=keyframes", GRID[-1]) == every
    assert most("selector=rbtm", "selector.window=3", "selector.fallback=skip", GRID[-1]) == every
    assert most("selector=rbtm,random_gap", "selector.window=3", GRID[-1]) == every


def test_what_follows_a_trajectory_is_unknown() -> None:
    assert most("selector=previous") == "guess=constant_velocity follows each run's trajectory"
    words = ("selector=oldest", "guess=identity,odometry", "target=single,local_map")
    assert most(*words) == "target=local_map follows each run's trajectory"
    assert most("backend=kiss_icp_system") == 0  # a system


@pytest.mark.parametrize("command", ["compare", "sweep"])
def test_the_bound_holds_and_comes_first(tmp_path: Path, command: str) -> None:
    words = ("backend=open3d_p2p", "selector=rbtm", "selector.window=4,7", "guess=identity")
    grid = (*words, "selector.threshold=0.3,0.9", "dataset.scans=12", f"out={tmp_path / 'o'}")
    code, _, err = call(command, *grid, "controls=none")
    assert code == 0
    bound = by_hand(12, 6)
    assert err.splitlines()[0].startswith(f"4 runs, all new; at most {bound} distinct")
    runs = [path.parent for path in (tmp_path / "o").glob("*/run.json")]
    computed = screen.of_runs(tmp_path / "o", screen.tables_of(runs)).split()
    assert 0 < int(computed[computed.index("computed") + 1].strip(",")) <= bound


@pytest.mark.parametrize("command", ["compare", "sweep"])
def test_what_is_resumed_is_counted_apart(tmp_path: Path, command: str) -> None:
    out = tmp_path / "o"
    assert (
        call(command, "backend=none", "seed=0,1,2", "guess=identity", *SMALL, f"out={out}")[0] == 0
    )
    first, *others = sorted(path.parent for path in out.glob("*/run.json"))
    (first / "run.json").unlink()
    code, _, err = call(command, "--resume", str(out))
    assert code == 0
    count = 3 if command == "sweep" else 1 + len(others)
    new = "1 new, " if others else "all new"
    assert f"{count} run" in err and new in err and "at most 11 distinct" in err
    assert ("about 0:01" in err) is bool(others)
    assert record_of(first)["status"] == "done"


def test_a_large_sweep_is_not_composed() -> None:
    seeds = ",".join(map(str, range(MOST_COMPOSED)))
    plan = SweepPlan.of([f"seed={seeds}", "selector.window=3,4", "controls=none"], ())
    assert plan.to_check(set())[1] == f"more than {MOST_COMPOSED} jobs are not looked into"
    assert len(plan.to_check({str(n) for n in range(2 * MOST_COMPOSED - 3)})[1]) == 3
