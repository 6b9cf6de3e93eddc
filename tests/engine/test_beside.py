"""Controls beside the runs of a grid: counted, made after what they are matched to, resumed."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from sweep_helpers import call, record_of, rows

from rbtm_bench.metrics.cost import COLUMNS
from rbtm_bench.runs.stored import read_run

WORDS = ("backend=open3d_p2p", "dataset.scans=30", "dataset.beams=91", "pictures=false")
GRID = (*WORDS, "selector.threshold=0.7,0.95")
OF_TIME = ("seconds", "reused", *COLUMNS)
"""Columns that say what a run cost, not what it gave."""
pytestmark = pytest.mark.slow


def numbers(out: Path) -> dict[str, dict[str, str]]:
    """The table without what depends on the machine."""
    return {
        name: {k: v for k, v in row.items() if k not in OF_TIME} for name, row in rows(out).items()
    }


@pytest.fixture(scope="module", params=["compare", "sweep"])
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory):
    """A comparison and a sweep, the command and what it said on standard error."""
    out = tmp_path_factory.mktemp(request.param) / "out"
    one = ("--jobs", "1") if request.param == "compare" else ()
    code, text, err = call(request.param, *GRID, f"out={out}", *one)
    assert code == 0
    return request.param, out, text, err


def test_controls_are_counted_before_and_made_after(made) -> None:
    _, out, text, err = made
    assert err.startswith("25 runs, 23 of them controls, all new; ")
    table = rows(out)
    assert len(table) == 25 and {row["status"] for row in table.values()} == {"done"}
    kinds = [row["control"].partition(",")[0] for row in table.values()]
    assert sorted(kinds) == [*[""] * 2, *["added"] * 2, *["matched"] * 2, *["rotated"] * 19]
    rotated = [line for line in text.splitlines() if line.startswith("+ ") and "shifted" in line]
    assert len(rotated) == 2, "one row in the tables of the best and of all"
    assert "when rbtm reached back (p, ratio to the median of 19 rotations of its gaps)" in text


def test_what_is_done_stays_and_the_rest_is_made_again(made, tmp_path: Path) -> None:
    """In a folder that has another name by now."""
    command, out, _, _ = made
    moved = tmp_path / "moved"
    shutil.copytree(out, moved)
    rotated = sorted(path for path in moved.iterdir() if "shifted_gap" in path.name)
    matched = next(path for path in moved.iterdir() if path.name.endswith(".keyframe"))
    for folder in (rotated[3], matched):
        (folder / "metrics.json").unlink()
    before = (rotated[4] / "run.json").stat().st_mtime_ns
    code, _, err = call(command, "--resume", str(moved))
    assert code == 0 and "25 runs, 23 of them controls: 2 new, 23 done before" in err
    assert (rotated[4] / "run.json").stat().st_mtime_ns == before
    assert numbers(moved) == numbers(out)
    code, _, err = call(command, "--resume", str(moved))
    assert code == 0 and "25 runs, 23 of them controls: 0 new, 25 done before" in err


def test_two_at_a_time_give_the_same_bits(made, tmp_path: Path) -> None:
    command, out, _, _ = made
    two = ("--jobs", "2")
    if command == "sweep":
        two = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2")
    assert call(command, *GRID, f"out={tmp_path / 'out'}", *two)[0] == 0
    assert numbers(tmp_path / "out") == numbers(out)


def test_no_rotation_is_the_run_itself(made, tmp_path: Path) -> None:
    """The selector with offset 0 gives the trajectory of the run whose gaps it takes."""
    _, out, _, _ = made
    rotated = next(path for path in out.iterdir() if path.name.endswith("shifted_gap-01"))
    source = Path(read_run(rotated).config["selector"]["gaps_from"])
    words = (*WORDS, "selector=shifted_gap", "selector.offset=0", f"out={tmp_path / 'o'}")
    assert call("run", *words, f"selector.gaps_from='{source}'")[0] == 0
    key = "trajectory_sha256"
    assert record_of(tmp_path / "o")[key] == record_of(source)[key] != record_of(rotated)[key]


def test_replicates_share_their_draws(tmp_path: Path) -> None:
    words = ("replicates=2", "backend=open3d_p2p", "dataset.scans=16", "dataset.beams=91")
    code, _, err = call("compare", *words, "pictures=false", f"out={tmp_path / 'o'}", "-j", "1")
    assert code == 0 and err.startswith("34 runs, 31 of them controls")
    runs = [read_run(path.parent) for path in (tmp_path / "o").glob("*/run.json")]
    for number in (1, 2):
        draws = [r.record["replicate"] for r in runs if r.config["replicate"] == number]
        assert len(draws) == 5
        assert len({(d["of"], d["seed"], d["number"], str(d.get("noise"))) for d in draws}) == 1
    matched = [r for r in runs if r.choices["selector"] == "keyframe"]
    assert len({r.method for r in matched}) == 1, "all copies are matched to one run"


def test_a_failed_rbtm_leaves_its_controls_out(tmp_path: Path) -> None:
    """Its rows say why; what could not be matched is no run that was left."""
    words = (*WORDS[:2], "selector.threshold=0.7", "registration.max_correspondence_distance=1e-9")
    code, _, err = call("compare", *words, f"out={tmp_path / 'o'}", "-j", "1")
    assert code == 1 and "not started" not in err
    assert "(and 20 more): no run of rbtm that it could be matched to has ended well" in err


def test_many_points_get_few_controls(tmp_path: Path) -> None:
    """Windows x thresholds: each window its own, rotations once."""
    grid = ("backend=none,open3d_p2p", "selector.window=4,6", "selector.threshold=0.5,0.7,0.9")
    code, _, err = call("sweep", *grid, "dataset.scans=8", f"out={tmp_path / 'o'}", "seed=0,1")
    assert code == 0
    # 24 jobs; previous for 2 seeds, 3 kinds for 2 windows and 2 seeds, rotations of a run of 7 gaps
    assert err.startswith(f"{24 + 2 + 12 + 19} runs, {2 + 12 + 19} of them controls, all new")
