"""``rbtm-bench calibrate`` end to end on simulated data."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from rbtm_bench.cli.commands import main

WORDS = [
    "calibrate",
    "dataset.scans=91",
    "backend=open3d_p2p,none",
    "similarity=curvature_circular,overlap",
    "--pairs=72",
    "--gaps=1,4,8",
    "--within=0.003,0.3",
    "--replicates=2",
]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A calibration with two processes, its folder and what it printed."""
    folder = tmp_path_factory.mktemp("calibrate")
    done = subprocess.run(
        [sys.executable, "-m", "rbtm_bench", *WORDS, "--jobs=2", "--out=made", "--write=my/a.yaml"],
        cwd=folder,
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "2"},
    )
    assert done.returncode == 0, done.stderr
    return folder / "made", done.stdout


def test_files(made: tuple[Path, str]) -> None:
    out, printed = made
    names = {p.name for p in out.iterdir()}
    assert {
        "report.txt", "summary.csv", "summary.md", "roc.csv", "curves.csv", "pairs.parquet",
        "scores.parquet", "calibration.json", "gaps.csv", "trials.csv", "runs", "roc_areas-gap.png",
        "roc_areas-gap.pdf",
        "error-overlap.png", "success-curvature_circular.pdf",
    } <= names  # fmt: skip
    assert not [n for n in names if "partial" in n]
    assert printed.startswith((out / "report.txt").read_text().rstrip())
    record = json.loads((out / "calibration.json").read_text())
    assert record["plan"]["gaps"] == [1, 4, 8] and record["command"].endswith("my/a.yaml")


def test_what_is_said(made: tuple[Path, str]) -> None:
    _, printed = made
    assert "truth      the data set's true poses" in printed
    assert "within 0.003 m and 0.3 deg" in printed
    assert "guess      odometry between the two scans" in printed
    assert "pairs that cross the cut" in printed
    assert "final position error (mm): median [quartiles] worst" in printed
    for backend in ("open3d_p2p", "none"):
        assert f"{backend}: the advice beside the references on the reported part" in printed
        assert f"  ADVICE for {backend}" in printed
    assert "not called" in printed  # two replicates bear nothing


def test_a_row_a_pair_and_backend(made: tuple[Path, str]) -> None:
    out, _ = made
    pairs = pd.read_parquet(out / "pairs.parquet")
    assert pairs.groupby(["backend", "part", "gap"]).size().to_dict() == {
        (b, p, g): 36
        for b in ("open3d_p2p", "none")
        for p in ("calibration", "reported")
        for g in (1, 4, 8)
    }
    good = (pairs["error_m"] <= 0.003) & (pairs["error_deg"] <= 0.3)
    assert (good == pairs["success"]).all() and 0 < good.mean() < 1
    report, calibration = (pairs[pairs["part"] == p] for p in ("reported", "calibration"))
    assert report["target"].min() > calibration["source"].max()


def test_areas_are_those_of_the_pairs(made: tuple[Path, str]) -> None:
    out, _ = made
    pairs = pd.read_parquet(out / "pairs.parquet").query("backend == 'none'")
    up, down = pairs[pairs["success"]]["gap"], pairs[~pairs["success"]]["gap"]
    less, ties = (
        np.mean(op(up.to_numpy()[:, None], down.to_numpy())) for op in (np.less, np.equal)
    )
    roc = pd.read_csv(out / "roc.csv")
    row = roc.query("backend == 'none' and predictor == 'gap' and part == 'all'")
    every = row[row["compared"] == "all gaps"]["auc"].item()
    assert every == pytest.approx(less + 0.5 * ties)
    assert row[row["compared"] == "equal gap"]["auc"].item() == 0.5  # gap is no help at equal gap
    costs = roc[roc["predictor"] == "overlap"]
    assert (costs["score_us"] > 0).all() and (costs["describe_us"] > 0).all()


def test_drift_is_predicted_and_what_was_run_is_a_row(made: tuple[Path, str]) -> None:
    out, _ = made
    gaps = pd.read_csv(out / "gaps.csv").set_index(["backend", "gap"])
    assert gaps.loc["open3d_p2p"].index.tolist() == [1, 4, 8]
    assert (gaps["drift_low_m"] <= gaps["drift_m"]).all() and gaps["unsure"].isna().all()
    # point-to-point sticks: every small step is short, and many add up
    assert gaps.loc[("open3d_p2p", 1), "mean_along_m"] < -1e-3
    assert gaps.loc[("open3d_p2p", 1), "drift_m"] > 3 * gaps.loc[("open3d_p2p", 8), "drift_m"]
    trials = pd.read_csv(out / "trials.csv")
    shown = trials[trials["part"] == "reported"]
    references = {"selector=previous", "selector=keyframe", "selector=rbtm"}
    for _, rows in trials.groupby(["backend", "part"]):
        assert references <= set(rows["words"]) and rows["advised"].sum() == 1
    assert (shown.groupby("backend").size() <= 4).all()
    assert (trials["q1"] <= trials["error"]).all() and (trials["replicates"] == 2).all()


def test_parts_are_run_with_replicates(made: tuple[Path, str]) -> None:
    out, _ = made
    scans = {"calibration": (0, 46), "reported": (46, 91)}
    for part, span in scans.items():
        runs = sorted((out / "runs" / part).glob("0-open3d_p2p-previous-*"))
        configs = [yaml.safe_load((run / "config.yaml").read_text()) for run in runs]
        assert [c["replicate"] for c in configs] == [1, 2]
        assert {(c["perturb"]["first_scan"], c["perturb"]["end_scan"]) for c in configs} == {span}


def test_the_yaml_is_used(made: tuple[Path, str], tmp_path: Path) -> None:
    out, printed = made
    path = out.parent / "my" / "experiment" / "a.yaml"
    assert f"--config-dir {Path('my')} +experiment=a" in printed
    words = ["run", "--config-dir", str(path.parents[1]), "+experiment=a", "dataset.scans=12"]
    assert main([*words, f"out={tmp_path / 'run'}"]) == 0
    config = yaml.safe_load((tmp_path / "run" / "config.yaml").read_text())
    chosen = json.loads((tmp_path / "run" / "run.json").read_text())["choices"]
    advice = json.loads((out / "calibration.json").read_text())["advice"][chosen["backend"]]
    trials = pd.read_csv(out / "trials.csv").query("part == 'reported'")
    wanted = trials[trials["setting"] == advice["setting" if advice["kept"] else "instead"]]
    assert f"selector={chosen['selector']}" in wanted["words"].iloc[0]
    for key, value in yaml.safe_load(path.read_text()).get("selector", {}).items():
        assert config["selector"][key] == value


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--within=1"], "--within 1: expected two numbers"),
        (["--within=a,b"], "--within a,b: expected numbers with commas between"),
        (["--gaps=1,x"], "--gaps 1,x: expected whole numbers"),
        (["--replicates=-1"], "--replicates -1: expected at least 0"),
        (["selector.window=5"], "selector.window=5: a calibration chooses the selector itself"),
        (["replicates=5"], "replicates=5: a calibration has --replicates N itself"),
        (["--jobs=0"], "--jobs 0: expected at least 1"),
        (["--write=a b.yaml"], "ending in .yaml"),
        (["--nix"], "--nix: no such option"),
        (["nix"], "nix: expected key=value"),
        (["backend=nix"], "nix"),
        (["dataset.nix=1"], "nix"),
        (["backend=kiss_icp_system"], "whole system"),
        (["--out=a", "out=b"], "--out and out=: give one of them"),
    ],
)
def test_mistakes_are_one_line(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    out = [] if any("out=" in w for w in words) else [f"--out={tmp_path / 'x'}"]
    assert main(["calibrate", *words, *out]) == 2
    err = capsys.readouterr().err
    assert message in err and len(err.splitlines()) == 1
    assert not (tmp_path / "x").exists()


def test_a_folder_that_holds_files_is_left_alone(
    made: tuple[Path, str], capsys: pytest.CaptureFixture[str]
) -> None:
    out, _ = made
    before = (out / "report.txt").stat().st_mtime_ns
    assert main(["calibrate", f"--out={out}"]) == 2
    assert "already holds files" in capsys.readouterr().err
    assert (out / "report.txt").stat().st_mtime_ns == before


def test_help_teaches(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "--help"]) == 0
    shown = capsys.readouterr().out
    for word in ("--replicates", "--within", "--write", "+experiment=corridor", "relations"):
        assert word in shown
