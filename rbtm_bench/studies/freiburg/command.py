"""The Freiburg logs (ACES, Intel, MIT CSAIL): every planar backend with every way to choose the
model scan, settings chosen on the other two logs, relations split local / long.

    python scripts/freiburg_table.py             every backend; an hour and a half on 2 cores
    python scripts/freiburg_table.py --quick     3 backends, the first scans of each log; minutes

The logs are looked for in RBTM_BENCH_DATA or --data: aces.clf.gz, aces.relations, intel...,
mit-csail..., in that folder or in freiburg/ below it. Leaves results/freiburg/README.md (what was
found, in words computed from the numbers), table.md, table.csv, differences.csv (RBTM against each
control, with each backend), pooled.csv (over all backends) and transfer.csv (what choosing
elsewhere costs). A run that was cut goes on where it was; --fresh starts anew.
"""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.files import make_folder, write_text
from rbtm_bench.core.guarded import guarded
from rbtm_bench.engine import drive, sweep_folder
from rbtm_bench.runs import stored
from rbtm_bench.runs.stored import Run
from rbtm_bench.studies.campaign import Campaign, begin
from rbtm_bench.studies.freiburg import numbers
from rbtm_bench.studies.freiburg.plan import (
    NOTHING,
    SLOW,
    SYSTEM,
    FreiburgPlan,
    find_logs,
    make_size,
)
from rbtm_bench.studies.freiburg.words import FreiburgTables, final_lines, markdown, readme
from rbtm_bench.studies.options import data_folder, make_parser

OUT = Path("results/freiburg")


def make_runs(plan: FreiburgPlan, folder: Path, jobs: int) -> Campaign:
    """All runs that are still missing, log by log; the slowest backends last."""
    fast = [name for name in plan.size.backends if name not in SLOW]
    slow = [name for name in plan.size.backends if name in SLOW]
    with drive.make_crew(jobs) as crew:
        maker = Campaign(folder, crew)
        for backends in ([NOTHING, SYSTEM, *fast], slow):
            for log in plan.logs if backends else ():
                maker.make(f"{log}, {len(backends)} backends", plan.points(log, backends))
    return maker


def read_runs(plan: FreiburgPlan, folder: Path) -> list[Run]:
    """The plan's runs in its order, failed ones too. Raises ``DataError`` for a missing one."""
    names = [NOTHING, SYSTEM, *plan.size.backends]
    points = [point for log in plan.logs for point in plan.points(log, names)]
    missing = [p.name for p in points if not (folder / p.name / "run.json").is_file()]
    if missing:
        raise DataError(f"{folder}: {len(missing)} runs are not there yet, e.g. {missing[0]}")
    return [stored.read_run(folder / point.name) for point in points]


def write(results: FreiburgTables, page: str, out: Path) -> list[Path]:
    """The page and the tables; returns the files."""
    texts = {
        "table.csv": results.table.to_csv(index=False),
        "differences.csv": results.differences.to_csv(index=False),
        "pooled.csv": results.pooled.to_csv(index=False),
        "transfer.csv": results.transfer.to_csv(index=False),
        "table.md": markdown(results.table) + "\n",
        "README.md": page,
    }
    for name, text in texts.items():
        write_text(out / name, text)
    return [out / name for name in texts]


def write_reference(results: FreiburgTables, page: str, folder: Path) -> None:
    """The page and a small table to be committed."""
    make_folder(folder)
    write_text(folder / "freiburg.md", page)
    write_text(folder / "freiburg.csv", numbers.small(results.table).to_csv(index=False))


def study(plan: FreiburgPlan, options: argparse.Namespace, command: str) -> int:
    """Everything in order; the last thing printed are the counts of RBTM against its controls."""
    started = time.perf_counter()
    folder = options.out / "runs"
    failed: dict[str, str] = {}
    if not options.no_runs:
        begin(folder, options.fresh)
        maker = make_runs(plan, folder, options.jobs)
        failed = maker.failed
        spent = (time.perf_counter() - started) / 60
        print(f"{maker.made} runs made in {spent:.1f} min, {options.jobs} side by side")
    runs = read_runs(plan, folder)
    chosen = numbers.choose(runs)
    results = FreiburgTables(
        numbers.table(chosen),
        numbers.differences(chosen, plan.size.backends),
        numbers.pooled(chosen, plan.size.backends),
        numbers.transfer(chosen, runs),
    )
    versions = runs[0].record.get("versions") or sweep_folder.versions()
    files = write(results, readme(results, plan.size, command, versions), options.out)
    if options.reference:
        page = readme(results, plan.size, command, versions, times=False)
        write_reference(results, page, options.reference)
    print("\n".join(map(str, files)))
    for name, reason in failed.items():
        print(f"failed: {name}: {reason}", file=sys.stderr)
    print("\n".join(final_lines(results)))
    return 1 if failed else 0


def command_of(options: argparse.Namespace) -> str:
    """The command that makes the same tables, wherever the data and the results are."""
    words = ["python", "scripts/freiburg_table.py"]
    words += ["--quick"] if options.quick else []
    words += ["--backends", options.backends] if options.backends else []
    words += ["--max-scans", str(options.max_scans)] if options.max_scans else []
    return shlex.join(words)


def main(words: Sequence[str] | None = None) -> int:
    parser = make_parser(__doc__, OUT, "freiburg.md and .csv")
    parser.add_argument("--quick", action="store_true", help="3 backends, first scans of each log")
    parser.add_argument("--max-scans", type=int, metavar="N", help="the first N of each log")
    parser.add_argument("--no-runs", action="store_true", help="tables of the runs that are there")
    options = parser.parse_args(words)

    def call() -> int:
        logs = find_logs(data_folder(options))
        size = make_size(options.quick, options.backends, options.max_scans)
        return study(FreiburgPlan(size, logs), options, command_of(options))

    return guarded(call, options.debug)
