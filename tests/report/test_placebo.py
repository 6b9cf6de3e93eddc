"""The placebo benchmark small on the corridor, and its twin."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sweep_helpers import script

from rbtm_bench.report.margin import DEFAULT

SMALL = ["--logs", "corridor", "--scans", "31", "--settings", "2", "--selectors", "keyframe"]


@pytest.fixture
def placebo(monkeypatch: pytest.MonkeyPatch) -> Any:
    folder = Path(__file__).parents[2] / "scripts" / "benchmarks"
    monkeypatch.syspath_prepend(folder)
    module = script("placebo")
    monkeypatch.setattr(module, "SIMULATED", 10)
    monkeypatch.setattr(module, "MORE", (12,))
    return module


@pytest.mark.slow
def test_the_tables_are_made_from_runs_that_are_kept(
    placebo: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    words = [*SMALL, "--replicates", "3", "--extra", "3", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", ["placebo.py", *words])
    placebo.main()
    out = capsys.readouterr().out
    for title in ("placebo: called different", "A/A", "power: twin", "plicp against open3d_p2p"):
        assert title in out
    assert out.count("corridor plicp keyframe") == 3 == out.count("corridor open3d_p2p keyframe")
    runs = sorted((tmp_path / "corridor").iterdir())
    assert len(runs) == 2 * (2 * 4 + 3)
    before = [(run / "run.json").stat().st_mtime_ns for run in runs]
    placebo.main()
    assert [(run / "run.json").stat().st_mtime_ns for run in runs] == before
    twins = sys.modules["placebo_twin"]
    stored = placebo.stored.find_runs([tmp_path])
    run = next(run for run in stored if placebo.number_of(run) == 2)
    key = "final_translation_error_mm"
    error = twins.twin_error(run, key)
    assert error(0.0) == pytest.approx(run.metrics[key], rel=1e-9)
    assert error(0.5) > 10 * error(0.0)


def test_one_method_against_itself_and_against_a_far_one(placebo: Any) -> None:
    values = np.random.default_rng(0).lognormal(0.0, 0.2, 20)
    assert placebo.compared(values[:10], values[10:]).holds == ""
    assert placebo.found(values * 3 * DEFAULT.factor, values, 10, other_draws=True) == 1.0
    assert placebo.found(values, values, 10, other_draws=True) == 0.0
    assert placebo.enough(values * 3 * DEFAULT.factor, values, 8, 0.5) == "12"
    assert placebo.factor_of([0.0, np.log(2.0)]) == pytest.approx(2.0**0.95)
