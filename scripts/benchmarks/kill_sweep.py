"""Kill a small sweep at random moments and resume it: its table must be that of a calm one.

    python scripts/benchmarks/kill_sweep.py --times 50

Kills come with signal 9, to the whole process group or (--parent-only) to the command alone,
whose workers must then go away by themselves. Exit code 1 if any table differs.
"""

from __future__ import annotations

import argparse
import csv
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from rbtm_bench.engine.sweep_folder import FILE, status
from rbtm_bench.metrics.cost import COLUMNS

WORDS = (
    "backend=none,open3d_p2p",
    "selector=previous,fixed_gap",
    "seed=0,1,2",
    "dataset.scans=45",
)
RUNS = 12
POLL_S = 0.002
A_RUN_S = 0.03
"""Less than the shortest of these runs takes."""
OF_TIME = ("seconds", "reused", *COLUMNS)
"""Columns that say what a run cost, not what it gave."""


def table(out: Path) -> list[dict[str, str]]:
    """A sweep's table without the columns of time."""
    with open(out / "table.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return [{key: value for key, value in row.items() if key not in OF_TIME} for row in rows]


@dataclass
class Trial:
    """Sweeps in ``folder`` that are killed, resumed, and held against a calm one."""

    folder: Path
    command: str = "sweep"
    extra: tuple[str, ...] = ()
    parent_only: bool = False
    quiet: bool = True
    random: random.Random = field(default_factory=random.Random)
    number: int = 0
    killed: Counter[str] = field(default_factory=Counter)
    equal: int = 0
    different: list[Path] = field(default_factory=list)

    def calm(self) -> float:
        """The sweep that nothing disturbs; its wall time in s is the span of the moments."""
        began = time.monotonic()
        code = self.start(self.folder / "calm").wait()
        rows = table(self.folder / "calm")
        if code != 0 or [row["status"] for row in rows] != ["done"] * RUNS:
            raise SystemExit(f"the calm sweep ended with exit code {code}")
        return time.monotonic() - began

    def start(self, out: Path) -> subprocess.Popen[bytes]:
        """Begin a sweep, or go on with one, in a process group of its own."""
        words = ["--resume", str(out)] if (out / FILE).exists() else self.fresh(out)
        return subprocess.Popen(
            [sys.executable, "-m", "rbtm_bench", self.command, *words],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL if self.quiet else None,
            start_new_session=True,
        )

    def fresh(self, out: Path) -> list[str]:
        """The words that begin a sweep."""
        return [*WORDS, f"out='{out}'", "overwrite=true", *self.extra]

    def kill_once(self, span: float) -> None:
        """Let the sweep go on and kill it at a random moment, every other time one while a run is
        being done; look at its table if it is done."""
        out = self.folder / f"sweep-{self.number}"
        moment = time.monotonic() + self.random.uniform(0.0, span)
        aimed = self.random.random() < 0.5
        process = self.start(out)
        code = process.poll()
        while code is None and time.monotonic() < moment:
            time.sleep(POLL_S)
            code = process.poll()
        while code is None and aimed and not self.in_a_run(out):
            time.sleep(POLL_S)
            code = process.poll()
        if code is None:
            time.sleep(self.random.uniform(0.0, A_RUN_S) if aimed else 0.0)
            if self.parent_only:
                process.kill()
            else:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        if code is not None:
            self.check(out, code)
            return
        begun = any(out.glob("*/run.json"))
        self.killed["during" if self.in_a_run(out) else "between" if begun else "before"] += 1

    def in_a_run(self, out: Path) -> bool:
        """True while a run has begun and not ended."""
        return "started" in [status(path.parent) for path in out.glob("*/run.json")]

    def check(self, out: Path, code: int) -> None:
        """Hold a finished sweep's table against the calm one's."""
        if code == 0 and table(out) == table(self.folder / "calm"):
            self.equal += 1
        else:
            self.different.append(out)
        self.number += 1

    def finish(self) -> None:
        """Resume the last sweep and leave it alone."""
        out = self.folder / f"sweep-{self.number}"
        self.check(out, self.start(out).wait())


def main(argv: list[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--times", type=int, default=50, help="kills (default: 50)")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument("--command", choices=["sweep", "compare"], default="sweep")
    parser.add_argument("--launcher", default="", help="hydra/launcher of a sweep")
    parser.add_argument("--parent-only", action="store_true", help="kill the command alone")
    parser.add_argument("--verbose", action="store_true", help="let the sweeps print")
    parser.add_argument("--out", type=Path, default=None, help="keep what is left there")
    options = parser.parse_args(argv)
    extra = (f"hydra/launcher={options.launcher}",) if options.launcher else ()
    folder = options.out or Path(tempfile.mkdtemp(prefix="kill_sweep-"))
    folder.mkdir(parents=True, exist_ok=True)
    chance = random.Random(options.seed)
    trial = Trial(folder, options.command, extra, options.parent_only, not options.verbose, chance)
    span = trial.calm()
    print(f"undisturbed: {RUNS} runs in {span:.1f} s")
    kills = 0
    while kills < options.times:
        before = sum(trial.killed.values())
        trial.kill_once(span)
        kills += sum(trial.killed.values()) > before
    trial.finish()
    if not options.out and not trial.different:
        shutil.rmtree(folder)
    moments = ", ".join(f"{count} {when}" for when, count in trial.killed.items())
    print(f"kills: {kills} ({moments} runs)")
    print(f"sweeps equal to the undisturbed one: {trial.equal}")
    print(f"sweeps that differ: {len(trial.different)}")
    for out in trial.different:
        print(f"  {out}")
    return 1 if trial.different else 0


if __name__ == "__main__":
    sys.exit(main())
