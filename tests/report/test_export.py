"""A run handed on: what is in the file, and that nothing is ever lost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from sweep_helpers import call, edit

from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.report.export import FORMATS


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("export") / "a run"
    words = ("dataset.scans=12", "dataset.beams=181", "backend=plicp", "pin=false")
    assert call("run", *words, f"out={out}")[0] == 0
    return out


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_row_a_scan(run: Path, tmp_path: Path, kind: str) -> None:
    assert call("export", str(run), "--to", kind, cwd=tmp_path)[:2] == (0, f"a run.{kind}\n")
    path = tmp_path / f"a run.{kind}"
    table = pd.read_csv(path) if kind == "csv" else pd.read_parquet(path)
    steps = pd.read_parquet(run / "steps.parquet")
    poses = np.loadtxt(run / "trajectory.tum")
    assert list(table)[:4] == ["scan", "stamp", "x", "y"]
    assert set(steps) <= set(table) and len(table) == 12
    assert (table[["stamp", "x", "y", "z", "qx", "qy", "qz", "qw"]].to_numpy() == poses).all()
    for name in ("gap", "score", "fitness"):
        pd.testing.assert_series_equal(table[name], steps[name], check_dtype=False)
    cell = table["localizability"][5]
    numbers = [float(word) for word in cell.split()] if kind == "csv" else cell
    assert list(numbers) == list(steps["localizability"][5])


def test_a_trajectory(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "path.tum"
    assert call("export", str(run), "--to", "tum", "--out", str(out))[0] == 0
    assert out.read_bytes() == (run / "trajectory.tum").read_bytes()
    assert len(Trajectory.read_tum(out)) == 12


@pytest.mark.parametrize("kind", FORMATS)
def test_nothing_is_written_over(run: Path, tmp_path: Path, kind: str) -> None:
    out = tmp_path / "file"
    out.write_text("mine")
    code, _, error = call("export", str(run), "--to", kind, "--out", str(out))
    assert code == 2 and "is there already" in error and out.read_text() == "mine"


@pytest.mark.parametrize(
    ("file", "content", "words"),
    [
        ("trajectory.tum", b"1 2 3\n", "3 columns: expected 8"),
        ("trajectory.tum", b"0 0 0 0 0 0 0 1\n", "1 poses for 12 scans"),
        ("trajectory.tum", b"\0\1", "trajectory.tum: cannot be read"),
        ("steps.parquet", b"no", "steps.parquet: not a readable table"),
        ("run.json", None, "the run is failed: nothing to export"),
    ],
)
def test_damage_leaves_nothing(
    run: Path, tmp_path: Path, file: str, content: bytes | None, words: str
) -> None:
    copy = tmp_path / "copy"
    copy.mkdir()
    for path in run.iterdir():
        (copy / path.name).write_bytes(path.read_bytes())
    if content is None:
        edit(copy / file, status="failed")
    else:
        (copy / file).write_bytes(content)
    code, out, error = call("export", "copy", "--to", "csv", "--out", "out.csv", cwd=tmp_path)
    assert (code, out) == (2, "") and words in error, error
    assert [path.name for path in tmp_path.iterdir()] == ["copy"]


def test_a_place_that_cannot_be_written(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "nowhere" / "a.csv"
    code, _, error = call("export", str(run), "--to", "csv", "--out", str(out))
    assert code == 1 and "a.csv: cannot be written" in error
