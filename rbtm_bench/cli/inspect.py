"""The subcommands that look into runs: show, diff."""

from __future__ import annotations

import argparse
from pathlib import Path

RUN = "a run's folder: results/runs/..., or FOLDER/NAME with the name that a table's column run has"


def show(words: list[str]) -> int:
    """``rbtm-bench show RUN``: what is behind a row of a table."""
    parser = argparse.ArgumentParser(
        prog="rbtm-bench show",
        description="What is behind a row of a table: the command that was typed and one that "
        "repeats just this run, every setting, the data, versions, machine, the main results and "
        "the files.",
        epilog="example: rbtm-bench show results/compare/open3d_p2p-rbtm-seed=0",
    )
    parser.add_argument("run", type=Path, metavar="RUN", help=RUN)
    options = parser.parse_args(words)
    from rbtm_bench.report import inspection

    print(inspection.run_text(inspection.find_run(options.run)))
    return 0


def diff(words: list[str]) -> int:
    """``rbtm-bench diff RUN RUN``: 0 if they are the same, 1 if anything differs."""
    parser = argparse.ArgumentParser(
        prog="rbtm-bench diff",
        description="What differs between two runs: settings, versions, data, results (to the "
        "last bit) and where the trajectories part. Times, memory, what was reused, the machine "
        "and settings that change no number do not count.",
        epilog="Exit code: 0 nothing differs, 1 something does, 2 a run cannot be read. Example: "
        "rbtm-bench diff results/a/none-previous results/b/none-previous && echo repeats",
    )
    parser.add_argument("runs", nargs=2, type=Path, metavar="RUN", help=RUN)
    options = parser.parse_args(words)
    from rbtm_bench.report import inspection

    a, b = (inspection.find_run(path) for path in options.runs)
    differences = inspection.compared(a, b)
    print(inspection.differences_text(a, b, differences))
    return 0 if differences.equal else 1
