"""The similarity band of a whole log, on one core: seconds for 1x, 2x and 4x the scans.

python scripts/benchmarks/bench_band.py aces.clf.gz
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from rbtm_bench.datasets.carmen import Carmen
from rbtm_bench.runs.pinning import pin_to_free_core
from rbtm_bench.similarity.curvature_circular import CurvatureCircular

REPEATS = 3


def main() -> None:
    """Measure the band of a quarter, a half and all of the log; the last line is the whole."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("log", type=Path)
    parser.add_argument("--window", type=int, default=100)
    options = parser.parse_args()
    pin_to_free_core()
    similarity = CurvatureCircular()
    descriptors = np.stack([similarity.describe(scan) for scan in Carmen(path=str(options.log))])
    similarity.band(descriptors[:500], options.window)
    seconds: dict[int, float] = {}
    for part in (4, 2, 1):
        some = descriptors[: len(descriptors) // part]
        times = []
        for _ in range(REPEATS):
            started = time.perf_counter()
            similarity.band(some, options.window)
            times.append(time.perf_counter() - started)
        seconds[part] = min(times)
        print(f"{len(some)} scans x {options.window} window: {seconds[part]:.3f} s")
    print(f"growth: 1x {1:.2f}, 2x {seconds[2] / seconds[4]:.2f}, 4x {seconds[1] / seconds[4]:.2f}")
    print(f"band_seconds: {seconds[1]:.3f}")


if __name__ == "__main__":
    main()
