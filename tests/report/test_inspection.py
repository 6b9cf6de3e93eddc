"""What is behind a run, and what differs between two."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stat_helpers import MM, make_run
from sweep_helpers import call, edit

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.report import inspection
from rbtm_bench.runs import stored

SELECTORS = "selector=previous,rbtm,random_gap"
GRID = ("backend=none", SELECTORS, "dataset.scans=12", "seed=7", "pictures=false")


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A comparison, run twice, as a user does it."""
    folder = tmp_path_factory.mktemp("inspection")
    for name in ("a", "b"):
        code, _, err = call("compare", *GRID, f"out={folder / name}", "--jobs", "1")
        assert code == 0, err
    return folder


# --- finding a run


def test_a_run_is_a_folder_or_the_only_one_in_it(tmp_path: Path) -> None:
    path = make_run(tmp_path / "out" / "deep" / "run", "previous", {})
    for place in (path, tmp_path / "out"):
        assert inspection.find_run(place).path == path


def test_what_is_no_run_names_the_runs_beside_it(tmp_path: Path) -> None:
    for name in ("none-previous", "none-rbtm", "p2p-previous", "p2p-rbtm", "p2p-oldest"):
        make_run(tmp_path / name, "previous", {})
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").touch()
    for name, why in (
        ("none-prevous", r"none-prevous: no such run\. Did you mean .*/none-previous or "),
        ("zzz", r"zzz: no such run\. Runs in .*: none-previous, none-rbtm, p2p-oldest, "),
        ("empty", "empty: holds no run"),
        ("file", "file: expected a run's folder"),
        (".", r"holds 5 runs, name one: .*none-previous, .* and 1 more"),
        ("nowhere/at/all", "all: no such run.$"),
    ):
        with pytest.raises(DataError, match=why) as caught:
            inspection.find_run(tmp_path / name)
        assert "\n" not in str(caught.value)


# --- show


def test_show_tells_all_on_a_screen(compared: Path) -> None:
    code, out, _ = call("show", str(compared / "a" / "none-rbtm"))
    assert code == 0 and len(out.splitlines()) <= 48
    assert all(len(line) <= 100 for line in out.splitlines() if str(compared) not in line)
    assert f"{compared}/a/none-rbtm: done in" in out
    flat = " ".join(out.split())
    for words in (
        "again rbtm-bench run",
        "data corridor: environment=paper scans=12",
        "12 scans, sha256 ",
        "backend none: max_correspondence_distance=0.3 voxel_size=0",
        "selector rbtm: window=10 window_m=null threshold=0.7",
        "check none target single",
        "other seed=7 replicates=1 controls=auto replicate=0 pin=True",
        "open3d 0.",
        "final position error",
        "metrics.json",
        "pinned to core",
    ):
        assert words in flat, words


@pytest.mark.parametrize("name", ["none-rbtm", "none-random_gap"])
def test_the_command_shown_repeats_the_run(compared: Path, tmp_path: Path, name: str) -> None:
    run = stored.read_run(compared / "a" / name)
    program, command, *words = shlex.split(inspection.again(run))
    assert (program, command) == ("rbtm-bench", "run")
    code, _, err = call("run", *words, f"out={tmp_path / 'again'}")
    assert code == 0, err
    code, out, _ = call("diff", str(run.path), str(tmp_path / "again"))
    assert code == 0, out


def test_folders_of_plug_ins_go_with_the_command(tmp_path: Path) -> None:
    path = make_run(tmp_path / "run", "mine", {})
    command = "rbtm-bench compare selector=mine,previous --config-dir '/my configs' out=x"
    edit(path / "run.json", command=command, overrides=["selector=mine", "seed=1", "out=x"])
    again = inspection.again(stored.read_run(path))
    assert again == "rbtm-bench run selector=mine seed=1 --config-dir '/my configs'"


def test_a_failed_run_and_one_without_much(tmp_path: Path) -> None:
    path = make_run(tmp_path / "run", "previous", None)
    edit(path / "run.json", reason="time limit of 5 s", finished="today")
    out = inspection.run_text(stored.read_run(path))
    assert out.startswith(f"{path}: failed, today: time limit of 5 s (more in run.json)")
    assert "results" not in out.splitlines() and "run.json" in out.splitlines()[-1]
    edit(path / "run.json", status="started", started="yesterday")
    assert "started, yesterday, never ended" in inspection.run_text(stored.read_run(path))


# --- diff


def test_the_same_run_twice_is_the_same(compared: Path) -> None:
    runs = [str(compared / name / "none-rbtm") for name in ("a", "b")]
    code, out, err = call("diff", *runs)
    assert (code, err) == (0, "")
    assert out.splitlines()[:2] == [f"- {runs[0]}", f"+ {runs[1]}"]
    assert out.splitlines()[-1] == "the same: settings, versions, data, results"


def test_gaps_of_a_run_of_the_same_name_are_the_same_setting(compared: Path) -> None:
    runs = [str(compared / name / "none-random_gap") for name in ("a", "b")]
    assert call("diff", *runs)[0] == 0


def test_another_selector_and_what_it_did(compared: Path) -> None:
    names = ("none-previous", "none-rbtm")
    code, out, _ = call("diff", *(str(compared / "a" / name) for name in names))
    assert code == 1
    settings = out[out.index("settings") : out.index("results")]
    assert re.search(r"selector +previous -> rbtm", settings)
    assert re.search(r"selector.window +- -> 10", settings) and "_target_" not in settings
    assert "backend" not in settings and "seed" not in settings
    assert out.splitlines()[-1].startswith("the same: versions, data")


def test_every_section_by_hand(tmp_path: Path) -> None:
    a = make_run(tmp_path / "a", "rbtm", {MM: 10.0, "ape_rmse_m": 1.0}, window=8)
    b = make_run(tmp_path / "b", "rbtm", {MM: 25.0, "ape_rmse_m": 1.0}, window=16, seed=3)
    edit(a / "run.json", versions={"numpy": "2.0", "scipy": "1.1"}, git="abc", host="one")
    edit(b / "run.json", versions={"numpy": "2.1", "scipy": "1.1"}, git="abc", host="two")
    edit(a / "run.json", dataset_fingerprint="0123456789abcdef")
    edit(b / "run.json", dataset_fingerprint="fedcba9876543210")
    differences = inspection.compared(stored.read_run(a), stored.read_run(b))
    assert differences.sections == {
        "settings": [
            "dataset.seed     0 -> 3",
            "seed             0 -> 3",
            "selector.window  8 -> 16",
        ],
        "versions": ["numpy  2.0 -> 2.1"],
        "data": ["dataset_fingerprint  0123456789ab -> fedcba987654"],
        "results": [f"{MM}  10 -> 25  (x 2.5)"],
    }
    assert differences.aside == ["host  one -> two"] and not differences.equal


def test_what_changes_no_number_does_not_count(tmp_path: Path) -> None:
    costs = {"ms_per_scan": 2.0, "ms_p50": 1.0, "reused": 0.0}
    a = make_run(tmp_path / "a", "rbtm", {MM: 1.0, **costs})
    b = make_run(tmp_path / "b", "rbtm", {MM: 1.0, "ms_per_scan": 4.0, "ms_p50": 3.0, "new": None})
    for path, more in ((a, "time_limit: 5\npairs: {store: off}"), (b, "map_resolution: 0.1")):
        with open(path / "config.yaml", "a") as file:
            file.write(more + "\nregistration: {voxel_size: 0.1}\n" if path == a else more + "\n")
    differences = inspection.compared(stored.read_run(a), stored.read_run(b))
    assert differences.equal and differences.aside == [
        "ms_per_scan  2 -> 4  (x 2)",
        "reused       0 -> -",
    ]


def test_the_last_bit_counts_and_shows(tmp_path: Path) -> None:
    third = 1 / 3
    a = make_run(tmp_path / "a", "rbtm", {MM: third})
    b = make_run(tmp_path / "b", "rbtm", {MM: float(np.nextafter(third, 1))})
    differences = inspection.compared(stored.read_run(a), stored.read_run(b))
    assert not differences.equal
    assert "0.3333333333333333 -> 0.33333333333333337" in differences.sections["results"][0]


def test_where_trajectories_part(tmp_path: Path) -> None:
    paths = [make_run(tmp_path / name, "rbtm", {MM: 1.0}) for name in "abc"]
    T = np.tile(np.eye(4), (6, 1, 1))
    other = T.copy()
    other[3:, 0, 3] = 0.5
    for path, poses in zip(paths, (T, other, T[:4]), strict=True):
        Trajectory(np.arange(len(poses), dtype=float), poses).write_tum(path / "trajectory.tum")
    runs = [stored.read_run(path) for path in paths]
    differences = inspection.compared(runs[0], runs[1]).sections["results"]
    assert differences == ["trajectory  from scan 3 on, at most 0.5 m and 0 deg apart"]
    assert inspection.compared(runs[0], runs[2]).sections["results"] == ["trajectory  6 -> 4 poses"]
    assert inspection.compared(runs[0], runs[0]).equal


def test_a_failed_run_differs_in_its_status(tmp_path: Path) -> None:
    a, b = (make_run(tmp_path / n, "rbtm", m) for n, m in (("a", {MM: 1.0}), ("b", None)))
    differences = inspection.compared(stored.read_run(a), stored.read_run(b))
    assert differences.sections["results"] == ["status  done -> failed", f"{MM}  1 -> -"]


def test_exit_code_of_a_mistake(tmp_path: Path) -> None:
    path = make_run(tmp_path / "run", "rbtm", {})
    for words in (["show", str(tmp_path / "nix")], ["diff", str(path), str(tmp_path / "nix")]):
        code, out, err = call(*words)
        assert (code, out) == (2, "") and err.count("\n") == 1
        assert err.startswith(f"rbtm-bench: {tmp_path / 'nix'}: no such run")
    assert call("diff", str(path))[0] == 2 and call("show")[0] == 2
    (path / "run.json").write_text("{")
    assert call("show", str(path))[0] == 2


def test_help_says_what_the_exit_codes_mean(capsys: Any) -> None:
    code, out, _ = call("diff", "--help")
    assert code == 0 and "0 nothing differs, 1 something does, 2 a run cannot be read" in " ".join(
        out.split()
    )
    assert "repeats just this run" in " ".join(call("show", "--help")[1].split())


def test_records_are_plain_json(compared: Path) -> None:
    """The fixture's runs hold what is compared: versions and a fingerprint."""
    record = json.loads((compared / "a" / "none-rbtm" / "run.json").read_text())
    assert record["versions"]["numpy"] and len(record["dataset_fingerprint"]) == 64
