"""Benchmarks that rest on the workbench's and the loop's interfaces still share, on a small log."""

from __future__ import annotations

from pathlib import Path

import numpy as np
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
