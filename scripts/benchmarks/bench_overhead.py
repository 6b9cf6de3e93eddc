"""What the framework costs: one run of ours over a bare Open3D loop doing the same registrations.

Log in memory, imports warm, one pinned core, metrics and files excluded; the median of five
alternations. The bare loop makes a point cloud a scan, takes the odometry between two scans as
the guess, calls ``registration_icp`` and chains the poses. Ours also checks its input, recomputes
fitness and inlier RMSE with the common evaluator, and records a row a scan.

    python scripts/benchmarks/bench_overhead.py aces.clf.gz
"""

from __future__ import annotations

import argparse
import statistics
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.runs import experiment
from rbtm_bench.runs.pinning import pin_to_free_core
from rbtm_bench.runs.settings import compose_settings

ALTERNATIONS = 5


def in_memory(parts: experiment.Parts) -> experiment.Parts:
    """The same with all scans read."""
    scans: Any = list(parts.dataset)
    return replace(parts, dataset=scans)


def ours(parts: experiment.Parts) -> tuple[float, float, Array]:
    """Seconds of a run, seconds of describing and selecting in it, and its last pose."""
    selecting = 0.0
    started = time.process_time()
    for step in odometry(parts.dataset, parts.method, None, 256):
        selecting += step.record.t_describe_s + step.record.t_select_s
    return time.process_time() - started, selecting, step.T_world_scan


def bare(parts: experiment.Parts) -> tuple[float, Array]:
    """Seconds of the hand-written loop, and its last pose."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    estimation = registration.TransformationEstimationPointToPoint(False)
    criteria = registration.ICPConvergenceCriteria(1e-6, 1e-6, 50)

    def cloud(scan: Scan) -> o3d.geometry.PointCloud:
        return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(scan.points))

    started = time.process_time()
    pose, before, target = np.eye(4), None, None
    for scan in parts.dataset:
        source = cloud(scan)
        if before is not None:
            guess = inverse(before.odometry) @ scan.odometry
            result = registration.registration_icp(source, target, 0.3, guess, estimation, criteria)
            T = np.asarray(result.transformation)
            x, y, theta = T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])
            c, s = np.cos(theta), np.sin(theta)
            pose = pose @ np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1.0]])
        before, target = scan, source
    return time.process_time() - started, pose


def main() -> None:
    """Measure and print; the last two lines are the figures."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("log", type=Path, help="aces.clf or aces.clf.gz")
    options = parser.parse_args()
    pin_to_free_core()
    words = ["dataset=carmen", f"dataset.path={options.log}", "backend=open3d_p2p"]
    previous = in_memory(experiment.instantiate(compose_settings([*words, "selector=previous"])))
    rbtm = experiment.instantiate(compose_settings([*words, "selector.window=100"]))
    rbtm = replace(rbtm, dataset=previous.dataset)
    ours(previous), bare(previous)
    ratios, shares = [], []
    for _ in range(ALTERNATIONS):
        mine, _, last = ours(previous)
        theirs, other = bare(previous)
        whole, selecting, _ = ours(rbtm)
        ratios.append(mine / theirs)
        shares.append(selecting / whole)
        print(f"ours {mine:.2f} s, bare {theirs:.2f} s, rbtm {whole:.2f} s")
    print(f"same last pose within {np.abs(last - other).max():.1e}")
    print(f"overhead_ratio: {statistics.median(ratios):.3f}")
    print(f"selection_share: {statistics.median(shares):.3f}")


if __name__ == "__main__":
    main()
