"""Two workers over one: the same 16-run sweep by the joblib launcher with n_jobs=1 and n_jobs=2.

Whole commands are timed, start-up included, in turn; the tables they leave must agree (times
aside).

    python scripts/benchmarks/bench_workers.py
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pandas as pd

from rbtm_bench.metrics.cost import COLUMNS

SWEEP = [
    "backend=open3d_gicp",
    "guess=odometry",
    "pairs.store=off",
    "selector.window=30",
    "selector.threshold=0.5,0.6,0.7,0.8",
    "seed=0,1,2,3",
    "controls=none",
    "hydra/launcher=joblib",
]
TIMES = ("seconds", *COLUMNS)


def sweep(jobs: int, scans: int, out: Path) -> tuple[float, pd.DataFrame]:
    """Seconds of the whole command and the table that it leaves."""
    command = [sys.executable, "-m", "rbtm_bench", "sweep", *SWEEP]
    command += [f"hydra.launcher.n_jobs={jobs}", f"dataset.scans={scans}", f"out={out}"]
    started = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    seconds = time.perf_counter() - started
    return seconds, pd.read_csv(out / "table.csv").drop(columns=list(TIMES))


def main() -> None:
    """Measure in turn and print the ratio last."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--alternations", type=int, default=2)
    parser.add_argument("--scans", type=int, default=1441, help="of a run")
    options = parser.parse_args()
    cores = len(os.sched_getaffinity(0))
    if cores < 2:
        sys.exit("bench_workers: one core only; two workers need two")
    ratios = []
    with tempfile.TemporaryDirectory() as folder:
        for turn in range(options.alternations):
            one, table_1 = sweep(1, options.scans, Path(folder) / f"one-{turn}")
            two, table_2 = sweep(2, options.scans, Path(folder) / f"two-{turn}")
            print(f"one worker {one:.1f} s, two workers {two:.1f} s")
            print(f"same table: {'yes' if table_1.equals(table_2) else 'no'}")
            ratios.append(one / two)
    print(f"speedup: {statistics.median(ratios):.2f}")


if __name__ == "__main__":
    main()
