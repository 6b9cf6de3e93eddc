"""Every 2D backend on consecutive keyframes of corrected logs: relative pose error in one table.

    python scripts/benchmarks/bench_corrected.py intel-corrected.log.gz csail-corrected.log.gz

The initial guess is the raw odometry (never the corrected pose); its own error is the first row.
The truth is the log's corrected pose, which is SLAM output: the floor below the table says how far
that can be trusted; methods within it of each other are equal. Settings are the backends' defaults
at one correspondence distance, chosen on no log. Means are over all pairs of a log, a registration
that raised counts with the error of its guess; near: within 0.1 m and 2 deg; ms: median of the
registration alone.
"""

from __future__ import annotations

import argparse
import csv
import statistics
import sys
from collections.abc import Sequence
from pathlib import Path

from bench_basin import NEAR_DEG, NEAR_M, backends_for

from rbtm_bench.calibration.known_pairs import (
    KnownPair,
    PairOutcome,
    errors_of,
    pairs_of,
    register_all,
)
from rbtm_bench.core.files import make_folder, write_atomically
from rbtm_bench.engine.progress import bar
from rbtm_bench.runs import assembly, settings
from rbtm_bench.runs.pinning import pin_to_free_core

FLOOR = (0.02, 0.3)
"""m and deg: what the corrected poses of neighbouring keyframes are taken to be good for."""
COLUMNS = ("log", "backend", "mean_m", "mean_deg", "near", "ms", "failed", "pairs")


def pairs_in(log: Path) -> list[KnownPair]:
    """Consecutive scans with corrected pose and odometry."""
    words = ["dataset=carmen", f"dataset.path='{log}'"]
    dataset = assembly.build(settings.compose_settings(words).config["dataset"])
    return [pair for pair in pairs_of(dataset) if pair.odometry is not None]


def guesses_of(pairs: list[KnownPair]) -> list[PairOutcome]:
    """What the raw odometry alone is off."""
    return [
        PairOutcome(*errors_of(pair.odometry, pair.T_target_source), 0.0)
        for pair in pairs
        if pair.odometry is not None
    ]


def row(
    log: Path, name: str, outcomes: list[PairOutcome], guesses: list[PairOutcome]
) -> list[object]:
    """One line of the table; a registration that raised leaves the guess."""
    ended = [guess if o.reason else o for o, guess in zip(outcomes, guesses, strict=True)]
    times = [o.seconds for o in outcomes if not o.reason]
    return [
        log.name.partition("-corrected")[0],
        name,
        statistics.fmean(o.metres for o in ended),
        statistics.fmean(o.degrees for o in ended),
        statistics.fmean(o.within(NEAR_M, NEAR_DEG) for o in ended),
        1e3 * statistics.median(times) if times else None,
        sum(bool(o.reason) for o in outcomes),
        len(outcomes),
    ]


def show(line: Sequence[object]) -> str:
    """One line as text."""
    log, name, metres, degrees, near, ms, failed, _ = line
    return f"{log:<14}{name:<18}{metres:8.4f}{degrees:8.3f}{near:8.0%}{ms:8.2f}{failed:7}"


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("logs", type=Path, nargs="+")
    parser.add_argument("--backends", default=None, help="names, by commas (default: all of 2D)")
    parser.add_argument("--distance", type=float, default=0.5, help="correspondence distance, m")
    parser.add_argument("--out", type=Path, default=Path("results/corrected"))
    options = parser.parse_args(argv)
    pin_to_free_core()
    words = [f"registration.max_correspondence_distance={options.distance}"]
    backends = backends_for(options.backends, True, ["dataset=carmen", "dataset.path=.", *words])
    lines = []
    print(f"{'log':<14}{'backend':<18}{'m':>8}{'deg':>8}{'near':>8}{'ms':>8}{'failed':>7}")
    with bar("backends", len(options.logs) * len(backends)) as progress:
        for log in options.logs:
            pairs = pairs_in(log)
            guesses = guesses_of(pairs)
            lines.append(row(log, "odometry", guesses, guesses))
            print(show(lines[-1]))
            for name, backend in backends.items():
                starts = [pair.odometry for pair in pairs if pair.odometry is not None]
                lines.append(row(log, name, list(register_all(backend, pairs, starts)), guesses))
                progress.step(name)
                print(show(lines[-1]), flush=True)
    make_folder(options.out)
    write_atomically(options.out / "corrected.csv", lambda path: _write(path, lines))
    print(f"floor: {FLOOR[0]:g} m, {FLOOR[1]:g} deg (the reference is SLAM output)")
    print(options.out / "corrected.csv")
    return 0


def _write(path: Path, lines: list[list[object]]) -> None:
    with open(path, "w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(COLUMNS)
        rows.writerows(lines)


if __name__ == "__main__":
    sys.exit(main())
