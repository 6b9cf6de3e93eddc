"""The shipped recipes run unchanged, and the page of their figures is made of what they wrote."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from sweep_helpers import call, script

pytestmark = pytest.mark.slow


def test_best_2d_on_a_real_log(tmp_path: Path, data_dir: Path) -> None:
    log = data_dir / "freiburg" / "mit-csail.clf.gz"
    words = ["run", str(log), "dataset.max_scans=200", "+experiment=best_2d", "loops=position"]
    code, _, error = call(*words, "pictures=false", f"out={tmp_path / 'run'}")
    assert code == 0, error
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert metrics["coverage"] > 0.95 and metrics["relations_translation_mean_m"] < 0.1
    assert metrics["looped_relations_translation_mean_m"] < 0.1


def test_best_3d_on_a_simulated_street(tmp_path: Path) -> None:
    words = ["run", "dataset=simulated", "dataset.scans=12", "dataset.azimuths=256"]
    code, _, error = call(
        *words, "+experiment=best_3d", "pictures=false", f"out={tmp_path / 'run'}"
    )
    assert code == 0, error
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert metrics["coverage"] == 1.0 and metrics["final_translation_error_mm"] < 300.0


def test_the_page_of_best_2d(tmp_path: Path, data_dir: Path) -> None:
    best = script("best")
    log = data_dir / "freiburg" / "mit-csail.clf.gz"
    words = best.words(log, 2, tmp_path / "mit-csail")
    code, _, error = call(*words, "dataset.max_scans=120", "-j", "1")
    assert code == 0, error
    cells = best.row(tmp_path / "mit-csail")
    assert len(cells) == len(best.SHOWN) + len(best.COSTS)
    assert all("worst" in cell for cell in cells[:2]) and float(cells[-2]) > 0.0
