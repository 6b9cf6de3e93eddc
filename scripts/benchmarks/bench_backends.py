"""What a backend costs: a preparation, a registration, its iterations, and what our wrapper adds.

    python scripts/benchmarks/bench_backends.py DATA    ACES, Intel (corrected), KITTI

One thread, one pinned core, everything compiled and warm. Both sides do the same registrations of
the same prepared scans in turn: `raw` is the library's call alone (for our own methods, their
kernels), `ours` is Backend.register, which also judges the result. Times are medians of --repeats.
`judge` is the common evaluator (fitness, RMSE, localizability), the same for every backend; `wrap`
is what is left of ours - raw: checks, conversions and the information matrix. It is too much where
it is over 5% of raw and over 50 us.
"""

from __future__ import annotations

import argparse
import csv
import functools
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from bench_basin import backends_for

from rbtm_bench.backends.base import Backend, Prepared
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.files import make_folder, write_atomically
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.engine.progress import bar
from rbtm_bench.odometry import judge
from rbtm_bench.odometry.judge import evaluate
from rbtm_bench.runs import assembly, settings
from rbtm_bench.runs.pinning import pin_to_free_core

DATA = {
    "aces": ("dataset=carmen", "dataset.path={}/freiburg/aces.clf.gz"),
    "intel": ("dataset=carmen", "dataset.path={}/corrected/intel-corrected.log.gz"),
    "kitti": ("dataset=kitti", "dataset.path={}/kitti", "dataset.sequence=0"),
}
PAIRS = {"aces": 60, "intel": 60, "kitti": 4}
GAP = {"aces": 5, "intel": 1, "kitti": 1}
COLUMNS = (
    *("data", "backend", "prepare_ms", "raw_ms", "ours_ms", "judge_us", "wrap_us", "wrap_share"),
    *("iterations", "points"),
)
Raw = Callable[[Prepared, Prepared, Array], Any]


def raw_call(backend: Backend) -> Raw:
    """The library's own call on its own objects, with nothing of ours around it."""
    name = type(backend).__name__
    if hasattr(backend, "icp"):
        return _raw_open3d(backend)
    if name == "KissICP":
        align = backend._registration.align_points_to_map  # type: ignore[attr-defined]
        distance, kernel = backend.max_correspondence_distance, backend.kernel  # type: ignore[attr-defined]
        return lambda s, t, T: align(s.native.kept, t.native.map, T, distance, kernel)
    return backend.align


def _raw_open3d(backend: Any) -> Raw:
    """Open3D's function with estimation and criteria made beforehand."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    kernel, criteria = backend.robust_kernel(), backend.criteria
    distance = backend.max_correspondence_distance
    call, estimation = {
        "Open3DPointToPoint": lambda: (
            registration.registration_icp,
            registration.TransformationEstimationPointToPoint(False),
        ),
        "Open3DPointToPlane": lambda: (
            registration.registration_icp,
            registration.TransformationEstimationPointToPlane(kernel),
        ),
        "Open3DGeneralizedICP": lambda: (
            registration.registration_generalized_icp,
            registration.TransformationEstimationForGeneralizedICP(backend.epsilon, kernel),
        ),
    }.get(type(backend).__name__, lambda: (None, None))()
    if call is None:
        return lambda s, t, T: backend.icp(s.native, t.native, distance, T)
    return lambda s, t, T: call(s.native, t.native, distance, T, estimation, criteria)


def measure(
    backend: Backend, scans: Sequence[tuple[Scan, Scan, Array]], repeats: int
) -> list[object]:
    """prepare, raw and ours in ms, judge and wrap in us, wrap's share, iterations, points."""
    raw = raw_call(backend)
    preparing, calling, registering, judging, iterations, points = [], [], [], [], [], []
    for target_scan, source_scan, guess in scans:
        backend.prepare(target_scan)
        target, source = backend.prepare(target_scan), backend.prepare(source_scan)
        judge.register(backend, source, target, guess)
        preparing.append(_median(lambda s=source_scan: backend.prepare(s), repeats))
        theirs, mine = [], []
        for _ in range(repeats):  # in turn, so that both see the same machine
            theirs.append(_timed(lambda t=target, s=source, g=guess: raw(s, t, g)))
            mine.append(
                _timed(lambda t=target, s=source, g=guess: judge.register(backend, s, t, g))
            )
        calling.append(statistics.median(theirs))
        registering.append(statistics.median(mine))
        result = judge.register(backend, source, target, guess)
        T, radius = result.T_target_source, backend.max_correspondence_distance
        judging.append(_median(functools.partial(evaluate, source, target, T, radius), repeats))
        iterations += [] if result.iterations is None else [result.iterations]
        points.append(len(source.points))
    raw_s, wrap_s = (
        statistics.median(calling),
        statistics.median(
            ours - theirs - judge
            for ours, theirs, judge in zip(registering, calling, judging, strict=True)
        ),
    )
    return [
        1e3 * statistics.median(preparing),
        1e3 * raw_s,
        1e3 * statistics.median(registering),
        1e6 * statistics.median(judging),
        1e6 * wrap_s,
        wrap_s / raw_s,
        statistics.median(iterations) if iterations else None,
        int(statistics.median(points)),
    ]


def _timed(call: Callable[[], object]) -> float:
    started = time.perf_counter()
    call()
    return time.perf_counter() - started


def _median(call: Callable[[], object], repeats: int) -> float:
    return statistics.median(_timed(call) for _ in range(repeats))


def pairs_in(name: str, folder: Path) -> tuple[list[tuple[Scan, Scan, Array]], list[str]]:
    """Target, source and guess of pairs spread over a data set, and its words."""
    words = [word.format(folder) for word in DATA[name]]
    dataset = assembly.build(settings.compose_settings(words).config["dataset"])
    starts = np.linspace(0, len(dataset) - 1 - GAP[name], PAIRS[name]).round().astype(int)
    pairs = []
    for i in starts.tolist():
        target, source = dataset[i], dataset[i + GAP[name]]
        if len(source.points) < 30 or len(target.points) < 30:
            continue
        known = target.odometry is not None and source.odometry is not None
        guess = inverse(target.odometry) @ source.odometry if known else np.eye(4)
        pairs.append((target, source, guess))
    return pairs, words


def show(line: Sequence[object]) -> str:
    """One row as text."""
    data, name, prepare, raw, ours, judge, wrap, share, iterations, points = line
    turns = "-" if iterations is None else f"{iterations:g}"
    return (
        f"{data:<7}{name:<18}{prepare:9.3f}{raw:9.3f}{ours:9.3f}{judge:9.0f}{wrap:9.0f}{share:8.0%}"
        f"{turns:>7}{points:8}"
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="holds freiburg/, corrected/ and kitti/")
    parser.add_argument("--data", default=",".join(DATA), help="some of: aces,intel,kitti")
    parser.add_argument("--backends", default=None, help="names, by commas (default: all that fit)")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--out", type=Path, default=Path("results/backends"))
    options = parser.parse_args(argv)
    pin_to_free_core()
    lines: list[list[object]] = []
    heads = ("prepare", "raw ms", "ours ms", "judge us", "wrap us", "share", "turns", "points")
    widths = (9, 9, 9, 9, 9, 8, 7, 8)
    heading = "".join(f"{h:>{w}}" for h, w in zip(heads, widths, strict=True))
    print(f"{'data':<7}{'backend':<18}{heading}")
    for name in options.data.split(","):
        pairs, words = pairs_in(name, options.folder.resolve())
        backends = backends_for(options.backends, pairs[0][0].planar, words)
        with bar(name, len(backends)) as progress:
            for backend_name, backend in backends.items():
                try:
                    numbers = measure(backend, pairs, options.repeats)
                except BackendError as error:
                    print(f"{name:<7}{backend_name:<18}{error}")
                    continue
                lines.append([name, backend_name, *numbers])
                progress.step(backend_name)
                print(show(lines[-1]), flush=True)
    make_folder(options.out)
    write_atomically(options.out / "backends.csv", lambda path: _write(path, lines))
    worst = [f"{d} {b}" for d, b, *_, us, share, _, _ in lines if us > 50 and share > 0.05]  # type: ignore[operator]
    print(f"wrapper over 5% and over 50 us: {', '.join(worst) or 'none'}")
    print(options.out / "backends.csv")
    return 0


def _write(path: Path, lines: list[list[object]]) -> None:
    with open(path, "w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(COLUMNS)
        rows.writerows(lines)


if __name__ == "__main__":
    sys.exit(main())
