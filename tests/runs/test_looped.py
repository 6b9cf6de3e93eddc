"""A run with loops: its files, its columns, and nothing changed of what was there before."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rbtm_bench.cli.commands import main
from rbtm_bench.core.columns import KNOWN
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.graph.g2o import read_g2o
from rbtm_bench.runs import assembly
from rbtm_bench.runs.settings import compose_settings

SMALL = ["dataset.scans=25", "dataset.beams=91", "backend=plicp", "selector=keyframe"]


def run(out: Path, *words: str) -> dict:
    assert main(["run", *SMALL, "pictures=false", f"out={out}", *words]) == 0
    return json.loads((out / "metrics.json").read_text())


def test_columns_and_files_of_their_own(tmp_path: Path) -> None:
    plain = run(tmp_path / "plain")
    looped = run(tmp_path / "looped", "loops=position")
    cost = {key for key in plain if key.startswith(("ms_", "real_", "peak_"))}
    assert {k: v for k, v in looped.items() if k in plain.keys() - cost} == {
        k: v for k, v in plain.items() if k not in cost
    }
    own = looped.keys() - plain.keys()
    assert {"loops", "loops_seconds", "looped_ape_rmse_m"} <= own
    assert all(key in KNOWN for key in own)
    # a straight corridor of 1.8 m has no loops: the same poses, the same errors
    assert looped["loops"] == looped["loops_candidates"] == 0
    assert looped["looped_ape_rmse_m"] == pytest.approx(looped["ape_rmse_m"])
    graph = read_g2o(tmp_path / "looped" / "graph.g2o")
    assert len(graph.scans) == 25 and len(graph.ends) == 24 and graph.planar
    trajectory = Trajectory.read_tum(tmp_path / "looped" / "looped.tum")
    before = Trajectory.read_tum(tmp_path / "plain" / "trajectory.tum")
    np.testing.assert_allclose(trajectory.T_world_scan, before.T_world_scan, atol=1e-12)
    for name in ("looped.tum", "graph.g2o"):
        assert not (tmp_path / "plain" / name).exists()


def test_runs_without_loops_are_the_same_as_before_there_were_any() -> None:
    identity = compose_settings(SMALL).identity
    assert "loops" not in identity.choices
    other = compose_settings([*SMALL, "loops=position"]).identity
    assert other.choices["loops"] == "position" and other.way != identity.way


def test_the_similarity_counts_where_loops_ask_for_it() -> None:
    assert "similarity" in compose_settings(SMALL).idle
    assert "similarity" not in compose_settings([*SMALL, "loops=similarity"]).idle
    with pytest.raises(ConfigError, match="similarity=overlap compares under a guess"):
        assembly.instantiate(compose_settings([*SMALL, "loops=similarity", "similarity=overlap"]))
