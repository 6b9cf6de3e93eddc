"""What commands cost before and beside their work: user and system seconds, children included.

    python scripts/benchmarks/bench_startup.py
    python scripts/benchmarks/bench_startup.py --before ../another-checkout

Every command is a process of its own, in a folder of its own; the median of its repetitions is
shown, with another checkout's beside it, measured in turn. ``run`` and ``compare`` make one run of
the corridor, all defaults. What the first of all compiles is not counted.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

COMMANDS = ("--help", "list", "doctor", "run dataset=corridor", "compare dataset=corridor")
OURS = Path(__file__).resolve().parents[2]


def cpu_seconds(command: str, checkout: Path) -> float:
    """User and system time of a command with the processes that it has waited for."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, "-m", "rbtm_bench", *command.split()],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(checkout)},
            capture_output=True,
            text=True,
        )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode and command != "doctor":  # which may know of something to mend
        sys.exit(f"{command}: {done.stderr.strip()}")
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--times", type=int, default=5, help="repetitions of a command")
    parser.add_argument("--before", type=Path, help="another checkout")
    options = parser.parse_args()
    checkouts = [OURS] if options.before is None else [options.before.resolve(), OURS]
    print(f"| command |{' before |' * (len(checkouts) - 1)} CPU s |")
    print(f"|---|{'---|' * len(checkouts)}")
    for command in COMMANDS:
        for checkout in checkouts:
            cpu_seconds(command, checkout)
        turns = [[cpu_seconds(command, one) for one in checkouts] for _ in range(options.times)]
        medians = [statistics.median(column) for column in zip(*turns, strict=True)]
        print(f"| `{command}` | {' | '.join(f'{seconds:.2f}' for seconds in medians)} |")


if __name__ == "__main__":
    main()
