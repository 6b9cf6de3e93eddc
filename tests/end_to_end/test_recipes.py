"""The shipped recipes run unchanged, and the page of their figures is made of what they wrote."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from sweep_helpers import TESTS, call, script

from rbtm_bench.runs.settings import compose_settings
from rbtm_bench.runs.words import data_words

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
    words = best.words(log, 2, tmp_path / "mit-csail", ["loops=position"])
    code, _, error = call(*words, "dataset.max_scans=120", "-j", "1")
    assert code == 0, error
    cells = best.row(tmp_path / "mit-csail")
    assert len(cells) == len(best.SHOWN) + len(best.COSTS)
    assert all("worst" in cell for cell in cells[:2]) and float(cells[-2]) > 0.0
    own, wheels, largest = best.by_relation(log, tmp_path / "mit-csail")
    counts = [int(cell.split("(")[1].rstrip(")")) for cell in (own, wheels)]
    assert counts == [638, 534], "more than 40 % of the log's relations are the wheels' own"
    assert float(largest) >= float(own.split()[0]) > float(wheels.split()[0])


def test_each_part_left_out_is_a_setting(data_dir: Path) -> None:
    """Every way of the ablation composes, and differs from the recipe in what it names alone."""
    best = script("best")
    log = str(data_dir / "freiburg" / "mit-csail.clf.gz")
    start = [*data_words(log, ()), "+experiment=best_2d"]
    recipe = compose_settings(start).identity.run
    made = {name: compose_settings([*start, *words]) for name, words in best.WITHOUT.items()}
    assert made["the recipe"].identity.run == recipe
    assert len({settings.identity.run for settings in made.values()}) == len(made)


def test_best_3d_beside_others() -> None:
    """KISS-ICP's, small_gicp's and the recipe's own run on one short street each."""
    program = TESTS.parent / "scripts" / "benchmarks" / "best_3d.py"
    words = [sys.executable, str(program), "street", "--seeds", "1", "--scans", "6"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()
    assert len(lines) == 4 and all(line.startswith("street") for line in lines[1:])
    assert all(0.0 < float(line[31:40]) < 1.0 for line in lines[1:])
