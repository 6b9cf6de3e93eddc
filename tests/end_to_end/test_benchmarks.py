"""Benchmarks that rest on the workbench's and the loop's interfaces still share, on a small log."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from sweep_helpers import script

from rbtm_bench.pairs.store import PairStore
from rbtm_bench.runs.workbench import Workbench

SCANS = 8


def log(path: Path) -> Path:
    """A CARMEN log of a room of 6 x 4 m that is crossed at 0.1 m a scan."""
    bearings = np.linspace(-np.pi / 2, np.pi / 2, 180)
    lines = []
    for scan in range(SCANS):
        x = 0.1 * scan
        with np.errstate(divide="ignore"):
            walls = [(5.0 - x) / np.cos(bearings), 2.5 / np.sin(bearings), -1.5 / np.sin(bearings)]
        ranges = np.min([np.where(wall > 0, wall, np.inf) for wall in walls], axis=0)
        words = [*(f"{one:.3f}" for one in ranges), *[f"{x} 0 0"] * 2]
        lines.append(f"FLASER 180 {' '.join(words)} {scan}.0 host {scan}.0\n")
    path.write_text("".join(lines))
    return path


@pytest.mark.parametrize("guess", ["odometry", "odometry_chain"])
def test_the_sweep_s_two_sides_agree_and_one_shares(tmp_path: Path, guess: str) -> None:
    bench = script("bench_sweep")
    points = bench.grid(str(log(tmp_path / "a.clf")), guess, None)[:3]
    with PairStore(tmp_path / "pairs") as store:
        workbench = Workbench(store, bench.MEMORY_MB)
        shared = bench.measure(workbench.parts(point) for point in points)
    alone = bench.measure(bench.plain(points))
    assert shared.digest == alone.digest and shared.asked == alone.asked >= 3 * (SCANS - 1)
    assert alone.reused == 0 and shared.reused >= 2 * (SCANS - 1)


def test_nees_against_chi_square() -> None:
    """Two registrations of 3 and 2 degrees of freedom: (4.5 + 5.5) / 5, of which one is inside."""
    bench = script("bench_nees")
    made = bench.consistency([4.5, 7.0], [3, 2])
    assert made.ratio == pytest.approx(11.5 / 5) and made.inside == 0.5
    assert (made.low, made.high) == pytest.approx((0.1662, 2.5665), abs=1e-3)  # chi2 of 5, over 5


def test_nees_of_a_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--draws", "1", "--places", "bare", "--backends", "plicp,none", "--out", str(tmp_path)]
    assert script("bench_nees").main(words) == 0
    table = pd.read_csv(tmp_path / "nees.csv")
    assert table["covariance"].tolist()[:2] == ["own", "localizability"]
    assert set(table["backend"]) == {"plicp"} and (table["freedom"] == 2).all()  # not the axis
    assert (tmp_path / "nees.md").read_text().strip() == capsys.readouterr().out.strip()


def test_the_knee_s_power(capsys: pytest.CaptureFixture[str]) -> None:
    bench = script("bench_knee")
    assert bench.main(["--experiments", "2", "--pairs", "400"]) == 0
    assert capsys.readouterr().out.count("400") == len(bench.SHAPES)
    s = np.array([0.2, 0.8])
    assert bench.level("threefold", s).tolist() == pytest.approx([np.log10(3.0), 0.0])
