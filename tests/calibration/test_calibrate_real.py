"""Calibrations of real data: relations, corrected poses, clouds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from rbtm_bench.calibration.plan import CalibrationPlan
from rbtm_bench.calibration.sampling import GAP, REVISIT, draw
from rbtm_bench.calibration.track import track_of
from rbtm_bench.cli.commands import main
from rbtm_bench.core.geometry import translation_norm
from rbtm_bench.datasets.carmen import Carmen
from rbtm_bench.datasets.kitti import Kitti


def test_relations_of_a_log(
    data_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = data_dir / "freiburg" / "mit-csail"
    words = ["dataset=carmen", f"dataset.path={log}.clf.gz", f"dataset.relations={log}.relations"]
    words += ["backend=plicp", "similarity=overlap", "--pairs=150", "--replicates=0"]
    words += [f"--out={tmp_path / 'a'}"]
    assert main(["calibrate", *words]) == 0
    shown = capsys.readouterr().out
    assert "the log's relations, up to 4 in a row as one" in shown
    assert "108 relations that cross the cut" in shown
    assert "534 local relations that are the wheels' motion, left out" in shown
    pairs = pd.read_parquet(tmp_path / "a" / "pairs.parquet")
    assert set(pairs["kind"]) == {GAP, REVISIT}
    assert pairs.query("kind == 'gap'")["success"].mean() > 0.85
    roc = pd.read_csv(tmp_path / "a" / "roc.csv").query("pairs == 'gap' and part == 'all'")
    equal = roc[(roc["predictor"] == "overlap") & (roc["compared"] == "equal gap")].iloc[0]
    assert equal["auc_low"] > 0.5  # more than gap in disguise, on this log
    assert (tmp_path / "a" / "roc_areas-revisit.png").is_file()


def test_corrected_poses_without_odometry(data_dir: Path) -> None:
    log = Carmen(str(data_dir / "corrected" / "orebro-corrected.log.gz"))
    sample = draw(track_of(log), CalibrationPlan(pairs=20, revisits=20))
    assert (
        sample.conditions["truth"] == "poses" and sample.conditions["guess"] == "constant_velocity"
    )
    across = (sample.rows["kind"] == GAP).to_numpy()
    off = translation_norm(np.linalg.inv(sample.truth) @ sample.guess)
    assert 0.0 < np.median(off[across]) < 0.5


def test_clouds_with_truth_for_some_frames(data_dir: Path) -> None:
    frames = Kitti(str(data_dir / "kitti"), ground_truth_frames=(14, 19))
    sample = draw(track_of(frames), CalibrationPlan(pairs=10))
    assert sample.rows["target"].min() == 14
    assert sample.rows.groupby("part").size().to_dict() == {"calibration": 2, "reported": 2}
    assert 1.0 < track_of(frames).reach < 100.0
