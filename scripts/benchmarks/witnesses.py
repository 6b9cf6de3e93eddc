"""Runs to hold a redesign against: made before it, made again after it, compared number by number.

    python scripts/benchmarks/witnesses.py make before     # at the old commit
    python scripts/benchmarks/witnesses.py make after      # at the new one
    python scripts/benchmarks/witnesses.py compare before after

Poses, decisions and metrics have to be the same bits, scores to agree within 1e-6, information
matrices within 1e-12 and what the judge adds up (RMSE, localizability) within 1e-9; times and what
depends on the machine's mood are left out. Every planar backend, eight in space, every selector,
similarity, guess, check and target, and a sweep; real data from RBTM_BENCH_DATA.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

SCORE_TOLERANCE = 1e-6
INFORMATION = 1e-12
JUDGED = 1e-9
MOOD = re.compile(r"t_.*_s$|ms_|real_time_factor|peak_memory|reused|seconds")
"""Columns and metrics that no two runs share."""

PLANAR = (
    "hsm,kiss_icp,kiss_icp_system,ndt_2d,none,open3d_gicp,open3d_ndt,open3d_p2p,open3d_p2plane,"
    "open3d_symmetric,plicp,plicp_p2p,psm,small_gicp_gicp,small_gicp_icp,small_gicp_vgicp"
)
IN_SPACE = (
    "kiss_icp,kiss_icp_system,open3d_gicp,open3d_ndt,open3d_p2p,open3d_p2plane,small_gicp_gicp,"
    "small_gicp_vgicp"
)
SELECTORS = (
    "best,fewest_hops,fixed_gap,keyframe,least_uncertain,oldest,oracle,previous,random_gap,rbtm,"
    "rbtm_verified"
)
SIMILARITIES = "curvature,curvature_circular,range_correlation,overlap,mutual_neighbours"
GUESSES = "odometry,odometry_chained,chain,constant_velocity,identity"


def commands(data: Path) -> dict[str, list[str]]:
    """The command behind each folder of witnesses."""
    freiburg = data / "freiburg"
    aces = ["dataset=carmen", f"dataset.path={freiburg / 'aces.clf.gz'}"]
    aces += [f"dataset.relations={freiburg / 'aces.relations'}"]
    turn = ["dataset=corridor", "dataset.environment=l_turn"]
    few = [*aces, "dataset.max_scans=200"]
    rbtm = ["selector=rbtm", "selector.window=10", "selector.threshold=0.7"]
    beams = "similarity=curvature_circular"
    grids = {
        "planar": [*aces, "dataset.max_scans=300", f"backend={PLANAR}", *rbtm, beams],
        "space": [
            *("dataset=kitti", f"dataset.path={data / 'kitti'}", f"backend={IN_SPACE}"),
            *("selector=rbtm", "selector.window=4", "selector.threshold=0.4"),
        ],
        "selectors": [
            *(*turn, "backend=plicp", f"selector={SELECTORS}", "check=gated"),
            *("selector.window=12", "seed=3", "guess_along_degenerate=0.01"),
        ],
        "similarities": [*few, "backend=open3d_p2plane", *rbtm, f"similarity={SIMILARITIES}"],
        "guesses": [
            *(*few, "backend=plicp", "selector=keyframe,rbtm", f"guess={GUESSES}", beams),
            *("selector.distance=0.3", "selector.threshold=0.7"),
        ],
        "targets": [
            *(*few, "backend=open3d_gicp", *rbtm, beams, "target=single,local_map"),
            *("check=none,gated", "selector.content=keyframes,scans", "selector.fallback=skip"),
            "selector.keyframe_distance=0.3",
        ],
    }
    sweep = [*few, "backend=open3d_p2p", "selector=rbtm", "selector.window=4,10", beams]
    bare = "controls=none"
    folders = {name: ["compare", *words, bare] for name, words in grids.items()}
    return {**folders, "sweep": ["sweep", *sweep, "selector.threshold=0.5,0.7", bare]}


def make(folder: Path) -> int:
    """Run every command into a folder of its own."""
    data = Path(os.environ["RBTM_BENCH_DATA"])
    for name, words in commands(data).items():
        out = folder / name
        done = subprocess.run(
            [sys.executable, "-m", "rbtm_bench", *words, f"out={out}"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        print(f"{name}: {len(list(out.glob('*/run.json')))} runs, exit code {done.returncode}")
        if done.returncode:
            print(done.stderr)
            return 1
    return 0


def differences(before: Path, after: Path) -> list[str]:
    """What differs between two run folders, in words."""
    if not (after / "run.json").is_file():
        return ["no such run"]
    lines = []
    statuses = [json.loads((run / "run.json").read_text())["status"] for run in (before, after)]
    if statuses[0] != statuses[1]:
        return [f"status {statuses[0]} became {statuses[1]}"]
    names = ("trajectory.tum", "metrics.json", "steps.parquet", "relations.parquet")
    for name in names:
        present = [(run / name).is_file() for run in (before, after)]
        if present[0] != present[1]:
            lines.append(f"{name}: present {present[0]}, now {present[1]}")
        elif all(present):
            lines += [f"{name}: {line}" for line in _file(before / name, after / name)]
    return lines


def _file(before: Path, after: Path) -> list[str]:
    if before.suffix == ".tum":
        return [] if before.read_bytes() == after.read_bytes() else ["poses differ"]
    if before.suffix == ".json":
        a, b = (json.loads(path.read_text()) for path in (before, after))
        keys = [key for key in {**a, **b} if not MOOD.match(key)]
        return [
            f"{k}: {a.get(k)} became {b.get(k)}"
            for k in keys
            if not (_close if k == "localizability" else _equal)(a.get(k), b.get(k))
        ]
    a, b = pd.read_parquet(before), pd.read_parquet(after)
    lines = []
    for column in [c for c in {**dict.fromkeys(a), **dict.fromkeys(b)} if not MOOD.match(c)]:
        if column not in a or column not in b or len(a) != len(b):
            lines.append(f"{column}: not in both, or of another length")
        elif column == "score":
            close = np.isclose(a[column], b[column], rtol=0, atol=SCORE_TOLERANCE, equal_nan=True)
            if not close.all():
                lines.append(f"score: {int((~close).sum())} rows differ")
        else:
            equal = RULES.get(column, _equal)
            off = [i for i in range(len(a)) if not equal(a[column][i], b[column][i])]
            if off:
                lines.append(f"{column}: {len(off)} rows differ, first {off[0]}")
    return lines


def _equal(a: Any, b: Any) -> bool:
    """The same to the bit; nothing equals nothing."""
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return np.array_equal(np.asarray(a, float), np.asarray(b, float), equal_nan=True)
    return bool(a == b or (pd.isna(a) and pd.isna(b)))


def _equal_information(a: Any, b: Any) -> bool:
    """The same symmetric part, within ``INFORMATION`` of its largest entry: since the matrices are
    symmetric to their last bit, that bit may be another."""
    if a is None or b is None:
        return a is b
    A, B = (0.5 * (M + M.T) for M in (np.reshape(a, (6, 6)), np.reshape(b, (6, 6))))
    return bool(np.abs(A - B).max() <= INFORMATION * np.abs(A).max())


def _close(a: Any, b: Any) -> bool:
    """Numbers, or arrays of them, within ``JUDGED``; nothing equals nothing."""
    if a is None or b is None:
        return a is b
    return bool(np.allclose(a, b, rtol=0, atol=JUDGED, equal_nan=True))


def _same_axis(a: Any, b: Any) -> bool:
    """Unit vectors along one line; loosely, since of two equal eigenvalues either may be named."""
    if a is None or b is None:
        return a is b
    return bool(abs(np.dot(a, b)) > 1.0 - 1e-6)


RULES = {
    "information": _equal_information,
    "inlier_rmse_m": _close,
    "localizability_min": _close,
    "localizability": _close,
    "weak_direction": _same_axis,
}
"""How columns of steps.parquet are compared; the others have to be the same bits."""


def compare(before: Path, after: Path) -> int:
    """Print what differs; 1 if anything does."""
    runs = sorted(path.parent.relative_to(before) for path in before.rglob("run.json"))
    differ = 0
    for run in runs:
        lines = differences(before / run, after / run)
        differ += bool(lines)
        for line in lines:
            print(f"{run}: {line}")
    print(f"{len(runs)} runs, {differ} differ")
    return int(differ > 0 or not runs)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands_ = parser.add_subparsers(dest="command", required=True)
    commands_.add_parser("make").add_argument("folder", type=Path)
    both = commands_.add_parser("compare")
    both.add_argument("before", type=Path)
    both.add_argument("after", type=Path)
    options = parser.parse_args()
    if options.command == "make":
        return make(options.folder)
    return compare(options.before, options.after)


if __name__ == "__main__":
    sys.exit(main())
