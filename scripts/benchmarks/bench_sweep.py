"""A sweep with and without shared work: 70 grid points, point-to-point ICP on the ACES log.

Windows 2, 4, 8, 16, 32, 64, 100 by thresholds 0.50, 0.55 ... 0.95, curvature_circular with a
half-span of 3 beams, a pure guess. Both sides run the same loop in one pinned process, warm,
serial, with the log in memory; metrics and files are left out. The plain side instantiates
plug-ins once and computes everything; the other takes them from a workbench with a pair store.

    python scripts/benchmarks/bench_sweep.py aces.clf.gz
    python scripts/benchmarks/bench_sweep.py aces.clf.gz --guess odometry_chain --scans 2000
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

from rbtm_bench.odometry.loop import odometry
from rbtm_bench.pairs.store import PairStore
from rbtm_bench.runs import assembly, experiment
from rbtm_bench.runs.pinning import pin_to_free_core
from rbtm_bench.runs.settings import Settings, compose_settings
from rbtm_bench.runs.workbench import Workbench

WINDOWS = (2, 4, 8, 16, 32, 64, 100)
THRESHOLDS = tuple(round(0.5 + 0.05 * step, 2) for step in range(10))
MEMORY_MB = 1000.0


@dataclasses.dataclass
class Side:
    """What one side did: its time, what it asked for and what of that was known, and a digest of
    every pose."""

    seconds: float
    asked: int
    distinct: int
    reused: int
    digest: str


SIMILARITY = "similarity=curvature_circular"


def grid(log: str, guess: str, scans: int | None) -> list[Settings]:
    """The 70 points."""
    words = ["dataset=carmen", f"dataset.path={log}", f"dataset.max_scans={scans or 'null'}"]
    words += ["backend=open3d_p2p", "selector=rbtm", SIMILARITY, f"guess={guess}"]
    base = compose_settings(words)
    points = []
    for window in WINDOWS:
        for threshold in THRESHOLDS:
            selector = {**base.config["selector"], "window": window, "threshold": threshold}
            points.append(dataclasses.replace(base, config={**base.config, "selector": selector}))
    return points


def measure(runs: Iterable[assembly.Parts]) -> Side:
    """Time the loops over all runs."""
    digest, asked, reused = hashlib.sha256(), 0, 0
    pairs: set[tuple[int | None, int]] = set()
    started = time.perf_counter()
    for parts in runs:
        for step in odometry(parts.dataset, parts.method, parts.work, experiment.BLOCK):
            digest.update(step.T_world_scan.tobytes())
            asked += step.record.registrations
            reused += bool(step.record.reused)
            if step.record.model is not None:
                pairs.add((step.record.model, step.record.scan))
    return Side(time.perf_counter() - started, asked, len(pairs), reused, digest.hexdigest())


def plain(points: list[Settings]) -> Iterable[assembly.Parts]:
    """The same plug-ins for every point, but for the selector."""
    first = assembly.instantiate(points[0])
    for point in points:
        selector = assembly.build(point.config["selector"])
        method = dataclasses.replace(first.method, selector=selector)
        yield dataclasses.replace(first, method=method)


def main() -> None:
    """Measure both sides and print the last five lines."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("log", type=Path, help="aces.clf or aces.clf.gz")
    parser.add_argument("--guess", default="odometry", help="odometry_chain, for one")
    parser.add_argument("--scans", type=int, help="the first so many only")
    options = parser.parse_args()
    pin_to_free_core()
    points = grid(str(options.log), options.guess, options.scans)
    measure(plain(points[:1]))  # imports and caches are warm for both sides
    with tempfile.TemporaryDirectory() as folder, PairStore(Path(folder)) as store:
        bench = Workbench(store, MEMORY_MB)
        shared = measure(bench.parts(point) for point in points)
        print(f"shared: {shared.seconds:.1f} s")
    alone = measure(plain(points))
    print(f"plain:  {alone.seconds:.1f} s")
    print(f"asked: {shared.asked}")
    print(f"distinct: {shared.distinct}")
    print(f"reused: {shared.reused}")
    print(f"identical: {'yes' if shared.digest == alone.digest else 'no'}")
    print(f"ratio_total: {alone.seconds / shared.seconds:.2f}")


if __name__ == "__main__":
    main()
