"""The recipe `+experiment=best_3d` on simulated places, beside KISS-ICP's and small_gicp's own
pipelines in the same run: where the last pose ends, and the CPU time of a scan.

    python scripts/benchmarks/best_3d.py --seeds 10

Every seed is another layout, other noise and other swaying. One pinned core, scans in memory;
everything from preparing to judging counts for the recipe. A table by place and way: median, worst
and quartiles over the seeds.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from functools import partial

import numpy as np
from bench_targets import Run, library, ours, relations_error

from rbtm_bench.core.geometry import inverse, translation_norm
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.runs import assembly
from rbtm_bench.runs.pinning import pin_to_free_core
from rbtm_bench.runs.settings import compose_settings

PLACES = ("street", "tunnel", "office")
LEAF = 0.25
"""m, the thinning of small_gicp's example."""
WAYS: dict[str, list[str]] = {
    "best_3d": ["+experiment=best_3d"],
    "KISS-ICP": ["backend=kiss_icp_system"],
    "small_gicp's example": [],
}


def main() -> None:
    """Print the table, a place after the other."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("places", nargs="*", default=list(PLACES))
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--scans", type=int, default=200)
    arguments = parser.parse_args()
    pin_to_free_core()
    head = ("end m", "quartiles", "worst", "mean APE", "ms a scan")
    print("{:8} {:22} {:>8} {:>17} {:>8} {:>9} {:>9}".format("place", "way", *head))
    for place in arguments.places:
        results: dict[str, list[tuple[float, float, float]]] = {way: [] for way in WAYS}
        for seed in range(arguments.seeds):
            data = [
                "dataset=simulated",
                f"dataset.place={place}",
                f"dataset.layout={seed}",
                f"dataset.scans={arguments.scans}",
                f"seed={seed}",
            ]
            parts = assembly.instantiate(compose_settings(data))
            scans = list(parts.dataset)
            for way, words in WAYS.items():
                results[way].append(measured(parts, scans, runner(data, words)))
        for way, rows in results.items():
            end, ape, cpu = np.array(rows).T
            low, middle, high = np.quantile(end, [0.25, 0.5, 0.75])
            spread = f"{low:.4f} - {high:.4f}"
            print(
                f"{place:8} {way:22} {middle:8.4f} {spread:>17} {end.max():8.4f} "
                f"{np.median(ape):9.4f} {np.median(cpu):9.2f}",
                flush=True,
            )


def runner(data: Sequence[str], words: Sequence[str]) -> Run:
    """The way, with everything new and compiled."""
    if not words:
        return partial(library, LEAF)
    run = ours([*data, *words])
    return run


def measured(parts: assembly.Parts, scans: Sequence[Scan], run: Run) -> tuple[float, float, float]:
    """The error of the last pose (m), the mean error of all positions (m), ms of CPU a scan."""
    started = time.process_time()
    poses, _ = run(scans)
    milliseconds = 1e3 * (time.process_time() - started) / len(scans)
    return relations_error(parts, scans, poses), mean_ape(scans, poses), milliseconds


def mean_ape(scans: Sequence[Scan], poses: Sequence[Array]) -> float:
    """Mean distance (m) of positions from the truth, both from the first pose."""
    truth = [scan.ground_truth for scan in scans]
    known = np.stack([T for T in truth if T is not None])
    off = inverse(inverse(known[0]) @ known) @ inverse(poses[0]) @ np.stack(list(poses))
    return float(translation_norm(off).mean())


if __name__ == "__main__":
    main()
