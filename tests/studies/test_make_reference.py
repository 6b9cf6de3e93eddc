"""The committed reference tables: remade where that is quick, and consistent with themselves."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from sweep_helpers import TESTS

from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.runs.stored import Run
from rbtm_bench.studies import reference

REFERENCE = TESTS.parent / "results" / "reference"

BACKEND, REMADE_SEEDS = "open3d_p2p", "5,6"
RELATIVE, ABSOLUTE = 1e-3, 0.01
"""Allowed where the versions or the processor are others than the file's. Other instructions (SSE
for AVX in numpy, OpenBLAS, MKL and numba) move these errors by 1e-9 mm; the rest is room for the
odd correspondence that falls the other way. ``ABSOLUTE`` is in the column's unit (mm, deg)."""

PAGES = {
    "corridor": lambda table, _: reference.corridor_page(table),
    "kitti": lambda table, _: reference.cloud_page(table),
    "paper_table1": lambda table, versions: reference.paper_page(table, versions),
}


def committed(name: str) -> pd.DataFrame:
    return pd.read_csv(REFERENCE / f"{name}.csv")


def test_corridor_is_remade_number_for_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All methods of one backend on two of the seeds: 12 runs of 125."""
    monkeypatch.setattr(reference, "SEEDS", REMADE_SEEDS)
    points = [p for p in reference.corridor_points(BACKEND) if not p.name.startswith("none")]
    table = reference.make("corridor", points, reference.corridor_rows, tmp_path / "runs", jobs=2)
    (tmp_path / "again.csv").write_text(reference.csv_text(table))
    again = pd.read_csv(tmp_path / "again.csv")
    known = committed("corridor")
    known = known[(known["backend"] == BACKEND) & known["seed"].isin([5, 6])]
    known = known.reset_index(drop=True)
    assert len(again) == len(known) == 12
    assert set(known["selector"]) >= {"previous", "rbtm", "random_gap", "fixed_gap"}
    same = reference.made_with() in (REFERENCE / "corridor.md").read_text(encoding="utf-8")
    words = ["backend", "selector", "settings", "seed", "registrations"]
    pd.testing.assert_frame_equal(again[words], known[words])
    numbers = [name for name in known if name not in words]
    rtol, atol = (0.0, 0.0) if same else (RELATIVE, ABSOLUTE)
    np.testing.assert_allclose(again[numbers], known[numbers], rtol=rtol, atol=atol)


@pytest.mark.parametrize("name", sorted(PAGES))
def test_pages_say_what_the_csv_files_hold(name: str) -> None:
    text = (REFERENCE / f"{name}.md").read_text(encoding="utf-8")
    *_, command, versions = re.split(r"\n\nMade by `(.*)` with ", text)
    again = PAGES[name](committed(name), versions.removesuffix(".\n"))
    *_, same_command, _ = re.split(r"\n\nMade by `(.*)` with ", again)
    assert again.rpartition("\n\nMade by ")[0] == text.rpartition("\n\nMade by ")[0]
    assert command == same_command and "make_reference.py" in command


@pytest.mark.parametrize("name", sorted(PAGES))
def test_tables_hold_no_time_date_or_path(name: str) -> None:
    for ending in ("md", "csv"):
        text = (REFERENCE / f"{name}.{ending}").read_text(encoding="utf-8")
        assert not re.search(r"20\d\d-\d\d|\bms\b|ms_per|seconds", text)
        assert not re.search(r"(?<![\w.])/\w+/\w", text)  # of a file, from the root
        assert len(text) < 60_000


def test_index_names_every_table() -> None:
    index = (REFERENCE / "README.md").read_text(encoding="utf-8")
    for file in REFERENCE.glob("*.csv"):
        assert f"[{file.stem}.md]({file.stem}.md)" in index


def test_kitti_is_scored_on_the_trusted_frames_alone(tmp_path: Path) -> None:
    """Steps of 1 m; the estimate of 1.1 m, and its last one turned by 10 deg."""
    truth = _line(np.arange(20.0))
    far = _line(1.1 * np.arange(20.0))
    turned = far.copy()
    c, s = np.cos(np.radians(10.0)), np.sin(np.radians(10.0))
    turned[-1, :2, :2] = [[c, -s], [s, c]]
    off = far.copy()
    off[:14, 0, 3] += 7.0  # before the trusted frames, where no poses count
    paths = {"kiss_icp": far, "open3d_p2p": turned, "small_gicp_icp": off}
    runs = [_run(tmp_path, backend, path) for backend, path in paths.items()]
    trusted = {k: truth[k] for k in range(14, 20)}
    rows = reference.cloud_rows(runs, trusted).set_index("backend")
    assert rows["error_m"].to_list() == pytest.approx([0.5, 0.5, 0.5])
    assert rows["step_error_m"].to_list() == pytest.approx([0.1, 0.1, 0.1])
    assert rows["error_deg"].to_list() == pytest.approx([0.0, 10.0, 0.0], abs=1e-6)
    assert rows.loc["open3d_p2p", "step_error_deg"] == pytest.approx(2.0)
    assert rows.loc["kiss_icp", "distance_before_m"] == pytest.approx(15.4)
    assert rows.loc["small_gicp_icp", "distance_before_m"] == pytest.approx(8.4)
    assert rows["from_median_before_m"].to_list() == pytest.approx([0.0, 0.0, 0.0])


def test_kitti_needs_all_frames(tmp_path: Path) -> None:
    short = _run(tmp_path, "kiss_icp", _line(np.arange(19.0)))
    with pytest.raises(reference.DataError, match="19 frames, expected 20"):
        reference.cloud_rows([short], {})


def _line(x: np.ndarray) -> np.ndarray:
    T = np.tile(np.eye(4), (len(x), 1, 1))
    T[:, 0, 3] = x
    return T


def _run(folder: Path, backend: str, T: np.ndarray) -> Run:
    """A run's folder with its path alone."""
    path = folder / backend
    path.mkdir()
    Trajectory(np.arange(float(len(T))), T).write_tum(path / "trajectory.tum")
    record = {"choices": {"backend": backend, "selector": "previous"}, "status": "done"}
    return Run(path, record, {"selector": {}}, {"mean_gap": 1.0})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({}, "run scripts/reproduce_paper.py first"),
        ({"shown_on": "seed=0-4"}, "not of a full run"),
        ({"backend": "open3d_p2p"}, "not of a full run"),
    ],
)
def test_paper_takes_a_full_run_only(change: dict[str, str], message: str, tmp_path: Path) -> None:
    if change:
        (tmp_path / "runs").mkdir()
        (tmp_path / "runs" / reference.STAMP).write_text('{"versions": {"numpy": "1"}}')
        committed("paper_table1").assign(ms_per_scan=1.0, **change).to_csv(tmp_path / "table1.csv")
    with pytest.raises(reference.DataError, match=message):
        reference.paper_files(tmp_path / "out", tmp_path)
    assert not (tmp_path / "out").exists()


def test_kitti_without_data_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.delenv("RBTM_BENCH_DATA", raising=False)
    assert reference.main(["kitti", "--runs", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "RBTM_BENCH_DATA" in error and len(error.splitlines()) == 1
