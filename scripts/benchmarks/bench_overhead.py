"""What the framework costs: runs of ours over bare loops that do the same registrations.

    python scripts/benchmarks/bench_overhead.py $RBTM_BENCH_DATA

Scans in memory, imports warm, one pinned core, metrics and files excluded; the CPU time of a whole
run, the median of five alternations. A bare loop (``bare_open3d``, ``bare_small_gicp`` below, read
them) is handed the pairs and initial guesses that our run asked for: it makes the library's clouds,
calls the library and chains the poses. Ours describes and selects, checks its input, judges every
registration by the common evaluator, and records a row a scan. `selection` is the share of
describing and selecting in ours; `p2p/previous` also with the guesses computed by the bare loop.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.runs import assembly, experiment
from rbtm_bench.runs.pinning import pin_to_free_core
from rbtm_bench.runs.settings import compose_settings

Attempt = tuple[int, int, Array]
"""Model, scan, and the guess of the motion between them."""

ACES = ["dataset=carmen", "dataset.path={data}/freiburg/aces.clf.gz", "backend=open3d_p2p"]
KITTI = ["dataset=kitti", "dataset.path={data}/kitti", "selector=previous"]
RBTM = ["selector=rbtm", "selector.window=100", "selector.threshold=0.7"]
RBTM += ["similarity=curvature_circular"]
WAYS = {
    "p2p/previous": [*ACES, "selector=previous", "guess=odometry"],
    "p2p/keyframe/chained": [*ACES, "selector=keyframe", "guess=odometry_chained"],
    "p2p/rbtm": [*ACES, *RBTM, "guess=odometry"],
    "p2p/rbtm/gated": [*ACES, *RBTM, "guess=odometry", "check=gated"],
    "gicp/previous": [*KITTI, "backend=small_gicp_gicp"],
    "vgicp/previous": [*KITTI, "backend=small_gicp_vgicp"],
}
BLOCK = experiment.BLOCK


def ours(parts: assembly.Parts) -> tuple[float, float, Array]:
    """CPU seconds of a run, seconds of describing and selecting in it, and its last pose."""
    selecting = 0.0
    started = time.process_time()
    for step in odometry(parts.dataset, parts.method, None, BLOCK):
        selecting += step.record.t_describe_s + step.record.t_select_s
    return time.process_time() - started, selecting, step.T_world_scan


def attempts_of(parts: assembly.Parts) -> tuple[list[Attempt], dict[int, int]]:
    """Every registration that a run asks for, and the attempt that each scan's pose is taken
    from."""
    asked: list[Attempt] = []
    backend = parts.method.backend
    register = backend.register

    def noted(source: Any, target: Any, T: Array) -> Any:
        asked.append((target.key[0][0], source.key[0][0], T.copy()))
        return register(source, target, T)

    backend.register = noted
    taken = {}
    for step in odometry(parts.dataset, parts.method):
        if step.record.model is not None:
            taken[step.record.scan] = len(asked) - 1
    del backend.register
    return asked, taken


def chained(pose: dict[int, Array], model: int, T: Array) -> Array:
    """The pose of a planar scan."""
    x, y, theta = T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])
    c, s = np.cos(theta), np.sin(theta)
    return pose[model] @ np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1.0]])


def bare_open3d(scans: list[Scan], asked: list[Attempt], taken: dict[int, int]) -> float:
    """CPU seconds of point-to-point ICP of the same pairs, chained."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    estimation = registration.TransformationEstimationPointToPoint(False)
    criteria = registration.ICPConvergenceCriteria(1e-6, 1e-6, 50)
    points = [np.array(scan.points) for scan in scans]  # the library refuses read-only arrays
    started = time.process_time()
    clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(one)) for one in points]
    pose = {0: np.eye(4)}
    for number, (model, scan, guess) in enumerate(asked):
        result = registration.registration_icp(
            clouds[scan], clouds[model], 0.3, guess, estimation, criteria
        )
        if taken.get(scan) == number:
            pose[scan] = chained(pose, model, np.asarray(result.transformation))
        elif scan not in pose:
            pose[scan] = pose[model] @ guess
    return time.process_time() - started


def bare_with_guesses(scans: list[Scan], asked: list[Attempt], taken: dict[int, int]) -> float:
    """The same for consecutive scans, the guess computed from wheel odometry."""
    started = time.process_time()
    mine = [
        (model, scan, inverse(scans[model].odometry) @ scans[scan].odometry)
        for model, scan, _ in asked
    ]
    return time.process_time() - started + bare_open3d(scans, mine, taken)


def bare_small_gicp(backend: Any, scans: list[Scan], asked: list[Attempt]) -> float:
    """CPU seconds of the library's preparation (``build``: its calls alone) and registrations."""
    from rbtm_bench.core.geometry import voxel_downsample

    started = time.process_time()
    clouds = [backend.build(voxel_downsample(s.points, backend.voxel_size), False) for s in scans]
    pose = {0: np.eye(4)}
    for model, scan, guess in asked:
        T = guess.copy()
        T[:3, 3] += backend.half_cell
        result = backend._call(clouds[scan], clouds[model], T, backend.max_iterations)
        pose[scan] = pose[model] @ result.T_target_source
    return time.process_time() - started


def main() -> None:
    """Measure and print a row a way."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("data", type=Path, help="the folder with freiburg/ and kitti/")
    parser.add_argument("--ways", default=",".join(WAYS), help="some of: %(default)s")
    parser.add_argument("--alternations", type=int, default=5)
    parser.add_argument("--scans", type=int, help="the first ones of each log alone")
    options = parser.parse_args()
    pin_to_free_core()
    print(f"{'way':22} {'scans':>6} {'ours s':>8} {'bare s':>8} {'ratio':>7} {'selection':>10}")
    for way in options.ways.split(","):
        words = [word.format(data=options.data) for word in WAYS[way]]
        if options.scans:
            words.append(f"dataset.max_scans={options.scans}")
        parts = assembly.instantiate(compose_settings(words))
        scans: Any = list(parts.dataset)
        parts = replace(parts, dataset=scans)
        asked, taken = attempts_of(parts)
        sides: dict[str, Callable[[], float]] = {}
        if way.startswith("p2p"):
            sides[way] = lambda a=asked, t=taken, s=scans: bare_open3d(s, a, t)
            if way == "p2p/previous":
                sides["  guesses computed"] = lambda a=asked, t=taken, s=scans: bare_with_guesses(
                    s, a, t
                )
        else:
            backend = parts.method.backend
            sides[way] = lambda a=asked, s=scans, b=backend: bare_small_gicp(b, s, a)
        ours(parts)
        for name, bare in sides.items():
            bare()
            rows = []
            for _ in range(options.alternations):
                mine, selecting, _ = ours(parts)
                theirs = bare()
                rows.append((mine, theirs, mine / theirs, selecting / mine))
            middle = [statistics.median(column) for column in zip(*rows, strict=True)]
            numbers = f"{middle[0]:8.3f} {middle[1]:8.3f} {middle[2]:7.3f} {middle[3]:10.3f}"
            print(f"{name:22} {len(scans):6} {numbers}", flush=True)


if __name__ == "__main__":
    main()
