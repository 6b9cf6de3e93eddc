"""What a scan is registered to: the error that each target ends with, and the CPU time of a scan.

    python scripts/benchmarks/bench_targets.py $RBTM_BENCH_DATA [planar] [street] [tunnel]

`planar`: ACES and MIT CSAIL, plicp, mean error of all relations. `street`, `tunnel`: simulated,
VGICP, KISS-ICP and their own pipelines side by side, distance of the last pose from the truth. One
pinned core, scans in memory; everything from preparing to judging counts. ``library`` is
small_gicp's own example of an odometry, a running map of Gaussian voxels, with nothing of ours.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from rbtm_bench.backends.system import System
from rbtm_bench.core.geometry import inverse, translation_norm
from rbtm_bench.core.trajectory import Trajectory, orthonormalised
from rbtm_bench.core.types import Array, Scan, StepRecord
from rbtm_bench.metrics.relations import RelationError
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.odometry.system import system_odometry
from rbtm_bench.runs import assembly, experiment
from rbtm_bench.runs.pinning import pin_to_free_core
from rbtm_bench.runs.settings import compose_settings

Run = Callable[[Sequence[Scan]], tuple[list[Array], list[StepRecord]]]
LOGS = {"aces": "freiburg/aces", "csail": "freiburg/mit-csail"}
PLANAR = ["backend=plicp", "guess=odometry_chained"]
SELECTORS = {
    "keyframe": ["selector=keyframe", "selector.distance=0.5"],
    "rbtm": ["selector=rbtm", "selector.window=10", "selector.content=keyframes"],
    "previous": ["selector=previous"],
}
TARGETS: dict[str, list[str]] = {
    "single": [],
    "keyframes 5": ["target=keyframes", "target.keyframes=5"],
    "keyframes 10": ["target=keyframes", "target.keyframes=10"],
    "keyframes 20": ["target=keyframes", "target.keyframes=20"],
    "around_model": ["target=around_model"],
    "map": ["target=map"],
}
VGICP = [
    *("backend=small_gicp_vgicp", "backend.translation_epsilon=1e-3"),
    "backend.rotation_epsilon=1.7453292519943296e-3",
]
"""With the library's own epsilons."""
THINNED = ("0.25", "0.5")
"""m, the library's own thinning and the product's."""
KISS = ["backend=kiss_icp", "backend.map_voxel_size=0.8", "registration.voxel_size=0"]
"""As the system has it: a hundredth of the range, no thinning but its own."""
SPACE: dict[str, list[str]] = {
    "vgicp previous single": [*VGICP, "selector=previous"],
    "vgicp keyframe keyframes 10": [*VGICP, "selector=keyframe", "target=keyframes"],
    **{
        f"vgicp previous map, {leaf} m": [
            *(*VGICP, "selector=previous", "target=map", f"registration.voxel_size={leaf}"),
        ]
        for leaf in THINNED
    },
    "plane keyframe map": ["backend=open3d_p2plane", "selector=keyframe", "target=map"],
    "kiss_icp previous map": [*KISS, "selector=previous", "target=map"],
    "kiss_icp_system": ["backend=kiss_icp_system"],
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="RBTM_BENCH_DATA")
    parser.add_argument("places", nargs="*", default=["planar", "street", "tunnel"])
    parser.add_argument("--only", default="", help="ways whose name has this in it")
    arguments = parser.parse_args()
    pin_to_free_core()
    print(f"{'data':8} {'way':34} {'error m':>9} {'ms a scan':>10} {'scans':>6} {'points':>7}")
    for place in arguments.places:
        rows = planar(arguments.data) if place == "planar" else space(place)
        for data, way, words in rows:
            if arguments.only in f"{data} {way}":
                row(data, way, words)


def planar(data: Path) -> Iterator[tuple[str, str, list[str]]]:
    """Logs of robots."""
    for log, name in LOGS.items():
        path = [f"dataset.path={data / name}.clf.gz", f"dataset.relations={data / name}.relations"]
        for selector, chosen in SELECTORS.items():
            for target, words in TARGETS.items():
                way = ["dataset=carmen", *path, *PLANAR, *chosen, *words]
                yield log, f"plicp {selector} {target}", way


def space(place: str) -> Iterator[tuple[str, str, list[str]]]:
    """A simulated place."""
    data = ["dataset=simulated", f"dataset.place={place}"]
    for leaf in THINNED:
        yield place, f"library small_gicp map, {leaf} m", data
    for way, words in SPACE.items():
        yield place, way, [*data, *words]


def row(data: str, way: str, words: Sequence[str]) -> None:
    """Run one way and print what it costs and where it ends."""
    parts = assembly.instantiate(compose_settings(list(words)))
    scans = list(parts.dataset)
    if way.startswith("library"):
        run: Run = partial(library, float(way.split()[-2]))
    else:
        ours(words)(scans[:3])  # compiles
        run = ours(words)
    started = time.process_time()
    poses, steps = run(scans)
    milliseconds = 1e3 * (time.process_time() - started) / len(scans)
    made = [record for record in steps if record.target_points is not None]
    members = np.mean([r.target_scans for r in made]) if made else np.nan
    points = np.mean([r.target_points for r in made]) if made else np.nan
    error = relations_error(parts, scans, poses)
    print(
        f"{data:8} {way:34} {error:9.4f} {milliseconds:10.3f} {members:6.1f} {points:7.0f}",
        flush=True,
    )


def ours(words: Sequence[str]) -> Run:
    """The product's loop, with everything new."""
    method = assembly.instantiate(compose_settings(list(words))).method

    def run(scans: Sequence[Scan]) -> tuple[list[Array], list[StepRecord]]:
        if isinstance(method, System):
            steps = list(system_odometry(iter(scans), method))
        else:
            steps = list(odometry(iter(scans), method, None, experiment.BLOCK))
        return [step.T_world_scan for step in steps], [step.record for step in steps]

    return run


def relations_error(parts: assembly.Parts, scans: Sequence[Scan], poses: list[Array]) -> float:
    """The mean error of all relations in m; without any the final position error."""
    relations = parts.dataset.relations
    if relations is not None:
        estimate = Trajectory(np.array([scan.stamp for scan in scans]), np.stack(poses))
        errors = RelationError().errors(estimate, relations)
        return float(np.nanmean(errors.translation_m))
    first, last = scans[0].ground_truth, scans[-1].ground_truth
    assert first is not None and last is not None
    off = inverse(inverse(first) @ last) @ inverse(poses[0]) @ poses[-1]
    return float(translation_norm(off))


def library(leaf: float, scans: Sequence[Scan]) -> tuple[list[Array], list[StepRecord]]:
    """small_gicp's own odometry by example: thin to ``leaf`` m, covariances, align to a running
    voxel map."""
    import small_gicp

    voxels = small_gicp.GaussianVoxelMap(1.0)
    voxels.set_lru(horizon=100, clear_cycle=10)
    poses: list[Array] = []
    for scan in scans:
        cloud, _ = small_gicp.preprocess_points(scan.points, leaf, 10, 1)
        if not poses:
            poses.append(np.eye(4))
        else:
            delta = inverse(poses[-2]) @ poses[-1] if len(poses) > 1 else np.eye(4)
            result = small_gicp.align(voxels, cloud, poses[-1] @ delta, num_threads=1)
            poses.append(orthonormalised(np.array(result.T_target_source)))
        voxels.insert(cloud, poses[-1])
    return poses, []


if __name__ == "__main__":
    main()
