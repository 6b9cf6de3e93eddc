"""A run that registered nothing is failed, whatever its poses are worth; its files stay."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rbtm_bench.cli.commands import main

SMALL = ["dataset.scans=6", "dataset.beams=91", "pin=false", "selector=previous"]
IMPOSSIBLE = ["backend=open3d_p2p", "check=gated", "check.min_fitness=1.0"]
IMPOSSIBLE += ["backend.max_correspondence_distance=0.001"]


def test_nothing_registered_is_a_failure(tmp_path: Path, capsys: Any) -> None:
    out = tmp_path / "dead"
    assert main(["run", *SMALL, *IMPOSSIBLE, f"out={out}"]) == 1
    assert "none of 5 scans was registered: " in capsys.readouterr().err
    record = json.loads((out / "run.json").read_text())
    assert record["status"] == "failed" and record["registered"] == 0
    for name in ("trajectory.tum", "steps.parquet", "metrics.json"):
        assert (out / name).is_file(), name


def test_a_dead_row_of_a_comparison_fails_it_and_a_baseline_does_not(
    tmp_path: Path, capsys: Any
) -> None:
    out = tmp_path / "both"
    assert main(["compare", *SMALL, *IMPOSSIBLE, f"out={out}", "--jobs", "1"]) == 1
    assert "alarm (status): 1 of 1 runs failed: none of 5 scans" in capsys.readouterr().out
    assert main(["run", *SMALL, "backend=none", f"out={tmp_path / 'none'}"]) == 0
    assert "the answer:" in capsys.readouterr().out
