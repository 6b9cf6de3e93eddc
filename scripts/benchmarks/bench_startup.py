"""What commands cost before their work begins: user and system seconds, children included.

    python scripts/benchmarks/bench_startup.py --times 5

Every command is a process of its own, in a folder of its own; the median of its repetitions is
shown. `run` and `compare` make one run of the corridor, all defaults.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import subprocess
import sys
import tempfile

COMMANDS = ("--help", "list", "doctor", "run dataset=corridor", "compare dataset=corridor")


def cpu_seconds(words: list[str], folder: str) -> float:
    """User and system time of one command, with the processes that it has waited for."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    program = [sys.executable, "-m", "rbtm_bench", *words]
    done = subprocess.run(program, cwd=folder, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode not in (0, 1) or (done.returncode and words != ["doctor"]):
        raise SystemExit(f"{' '.join(words)}: {done.stderr.strip()}")
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--times", type=int, default=5, help="repetitions of a command")
    options = parser.parse_args()
    print("| command | CPU s (least, most) |\n|---|---|")
    for command in COMMANDS:
        seconds = []
        for _ in range(options.times):
            with tempfile.TemporaryDirectory() as folder:
                seconds.append(cpu_seconds(command.split(), folder))
        middle, least, most = statistics.median(seconds), min(seconds), max(seconds)
        print(f"| `{command}` | {middle:.2f} ({least:.2f}, {most:.2f}) |", flush=True)


if __name__ == "__main__":
    main()
