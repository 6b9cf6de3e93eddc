"""Peak memory of a run over a log and over the same log four times as long.

Each loop is a process of its own; its peak is the kernel's (ru_maxrss). The recorded steps, which
grow with the log by design, are left out: each is dropped when it comes.

    python scripts/benchmarks/bench_memory.py aces.clf.gz
"""

from __future__ import annotations

import argparse
import gzip
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

REPEAT = 4


def child(log: str) -> None:
    """Run the loop over a log and print the peak in MB."""
    from rbtm_bench.odometry.loop import odometry
    from rbtm_bench.runs import assembly
    from rbtm_bench.runs.pinning import pin_to_free_core
    from rbtm_bench.runs.settings import compose_settings

    pin_to_free_core()
    words = ["dataset=carmen", f"dataset.path='{log}'", "selector=rbtm", "selector.window=100"]
    words += ["similarity=curvature_circular", "selector.threshold=0.7"]
    parts = assembly.instantiate(compose_settings(words))
    opened = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    count = sum(1 for _ in odometry(parts.dataset, parts.method))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{count} {opened:.1f} {peak:.1f}")


def repeated(log: Path, folder: Path) -> Path:
    """The log's lines, four times over (time goes on, so that stamps stay apart)."""
    opener = gzip.open if log.suffix == ".gz" else open
    with opener(log, "rt", encoding="utf-8", errors="replace") as file:
        lines = [line for line in file if line.startswith("FLASER")]
    out = folder / "repeated.clf"
    with open(out, "w", encoding="utf-8") as file:
        for turn in range(REPEAT):
            for line in lines:
                words = line.split()
                words[-3] = f"{float(words[-3]) + 1e6 * turn:.6f}"
                file.write(" ".join(words) + "\n")
    return out


def main() -> None:
    """Measure both and print the ratio last."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("log", type=Path)
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        return child(str(options.log))
    peaks = []
    with tempfile.TemporaryDirectory() as folder:
        for log in (options.log, repeated(options.log, Path(folder))):
            command = [sys.executable, __file__, str(log), "--child"]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            scans, opened, peak = map(float, done.stdout.split())
            print(
                f"{scans:.0f} scans: {opened:.0f} MB with the log open, {peak:.0f} MB at the peak"
            )
            peaks.append((opened, peak))
    (opened_1, peak_1), (opened_4, peak_4) = peaks
    print(f"opening the longer log: {opened_4 - opened_1:+.0f} MB")
    print(f"the loop: {peak_1 - opened_1:.0f} MB, then {peak_4 - opened_4:.0f} MB")
    print(f"peak_ratio: {peak_4 / peak_1:.3f}")
    return None


if __name__ == "__main__":
    main()
