"""The paper's experiment from scratch: Fig. 1(b, c), 2, 3, 4(a, b), Table I; what it leaves open.

    python scripts/reproduce_paper.py            20 seeds, every planar backend
    python scripts/reproduce_paper.py --quick    5 seeds, fewer backends; minutes, for CI

Every row of Table I gets equally many tries on seeds that are not shown. Leaves
results/paper/README.md (what was found, what the paper leaves open and what was chosen),
table1.csv and table1.md, choices.csv, ratio.csv, open_settings.csv, and the figures as PNG and
PDF. A run that was cut goes on where it was; --fresh starts anew.
"""

from __future__ import annotations

import argparse
import resource
import shlex
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rbtm_bench.core.files import write_text
from rbtm_bench.core.guarded import guarded
from rbtm_bench.engine import drive
from rbtm_bench.runs.grid import Point
from rbtm_bench.studies.campaign import Campaign, begin
from rbtm_bench.studies.paper import tables as numbers
from rbtm_bench.studies.paper.figures import draw
from rbtm_bench.studies.paper.plan import (
    PAPER_BACKEND,
    PaperSize,
    PlannedRuns,
    TableOne,
    add_open,
    add_ratio,
    make_size,
)
from rbtm_bench.studies.paper.words import final_words, readme, table_page

OUT = Path("results/paper")
PICTURES = {"pictures": True, "map_resolution": 0.02}
"""Settings of the runs that figures show; 2 cm between the points of a map."""


def in_turn(runs: PlannedRuns) -> list[Point]:
    """The runs on the same data one after the other."""
    return sorted(runs.points.values(), key=lambda point: point.name.rpartition("-")[2])


def reproduce(size: PaperSize, out: Path, jobs: int, command: str) -> int:
    """Everything in order; the last thing printed is Table I."""
    started = time.perf_counter()
    folder = out / "runs"
    with drive.make_crew(jobs) as crew:
        maker = Campaign(folder, crew)
        table = TableOne(size)

        # Every row's setting is the best of its tries on seeds that nothing below shows.
        runs = PlannedRuns()
        for way in table.ways.values():
            for backend in size.backends:
                for k in range(len(way.values)):
                    table.add(runs, way.key, k, backend, choosing=True)
        maker.make("choosing settings", in_turn(runs))
        choices = numbers.choices(folder, table.ways, size)
        chosen = numbers.chosen(choices)

        # Table I on the seeds that are shown.
        runs = PlannedRuns()
        for (key, backend), k in chosen.items():
            table.add(runs, key, k, backend, choosing=False)
        maker.make("Table I", in_turn(runs))
        table1 = numbers.table1(folder, table.ways, size, chosen)

        # The ratio over what the paper leaves open, and every open setting by itself.
        runs = PlannedRuns()
        of_paper = {way: k for (way, backend), k in chosen.items() if backend == PAPER_BACKEND}
        cells, changes = add_ratio(runs, size, of_paper), add_open(runs, size, of_paper)
        maker.make("ratio and open settings", in_turn(runs))
        ratio = numbers.ratios(folder, cells)
        open_settings = numbers.open_settings(folder, changes)

        # Maps and matrices of a run that is neither the best nor the worst.
        runs = PlannedRuns()
        shown = add_figures(runs, table, of_paper, folder)
        maker.make("figures", in_turn(runs))

    for name, rows in (
        ("choices", choices), ("table1", table1), ("ratio", ratio), ("open_settings", open_settings)
    ):  # fmt: skip
        write_text(out / f"{name}.csv", rows.to_csv(index=False))
    files = draw(folder, out, table, of_paper, shown, table1, ratio)
    write_text(out / "table1.md", table_page(table1, size))
    spent = time.perf_counter() - started, cpu_seconds()
    cost = cost_words(maker.made, jobs, *spent)
    page = readme(command, size, choices, table1, ratio, open_settings, shown, folder)
    write_text(out / "README.md", page)
    shutil.rmtree(folder / "pairs", ignore_errors=True)  # registrations: of no use any more
    for file in [out / "README.md", *files]:
        print(file)
    print(cost)
    for name, reason in maker.failed.items():
        print(f"failed: {name}: {reason}", file=sys.stderr)
    print(final_words(table1, size))
    return 1 if maker.failed else 0


def add_figures(
    runs: PlannedRuns, table: TableOne, chosen: dict[str, int], folder: Path
) -> dict[str, list[str]]:
    """Add the runs that figures show, with their maps and matrices; returns their names by way.

    Those with noise are of one seed: the one at which the standard ICP's error is its median.
    """
    key, seeds = table.size.replicates(table.ways["standard"].noise_mm, choosing=False)
    stem = f"standard-{chosen['standard'] + 1}-{PAPER_BACKEND}"
    middle = numbers.median_run(folder, [f"{stem}-{seed}" for seed in seeds])
    shown: dict[str, list[str]] = {}
    for way in ("standard", "circular", "literal", "literal_clean"):
        settings = table.settings(way, chosen[way], PAPER_BACKEND)
        settings = replace(settings, config={**settings.config, **PICTURES})
        clean = table.size.replicates(0.0, choosing=False)
        replicates = (
            (clean[0], clean[1][:1])
            if way == "literal_clean"
            else (key, [int(numbers.replicate(middle))])
        )
        shown[way] = runs.add(f"figure-{way}", settings, replicates)
    return shown


def cpu_seconds() -> float:
    """Of this process and of its children, s."""
    return sum(
        used.ru_utime + used.ru_stime
        for used in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    )


def cost_words(made: int, jobs: int, wall: float, cpu: float) -> str:
    return (
        f"{made} runs made in {wall / 60:.1f} min ({cpu / 60:.1f} min of processor time, "
        f"{jobs} side by side)"
    )


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="5 seeds, fewer backends, small grids")
    parser.add_argument("--out", type=Path, default=OUT, help=f"folder (default {OUT})")
    parser.add_argument("--seeds", type=int, help="seeds that are shown")
    parser.add_argument("--scans", type=int, help="scans on the path (default 181)")
    parser.add_argument("--backends", help=f"a comma list that holds {PAPER_BACKEND}")
    parser.add_argument("--jobs", "-j", type=int, default=drive.default_jobs())
    parser.add_argument("--fresh", action="store_true", help="keep no run of an earlier call")
    parser.add_argument("--debug", action="store_true", help="errors with their whole traceback")
    options = parser.parse_args(words)

    def call() -> int:
        backends = options.backends.split(",") if options.backends else None
        size = make_size(options.quick, options.seeds, options.scans, backends)
        begin(options.out / "runs", options.fresh)
        command = shlex.join(["python", "scripts/reproduce_paper.py", *(words or sys.argv[1:])])
        return reproduce(size, options.out, options.jobs, command)

    return guarded(call, options.debug)
