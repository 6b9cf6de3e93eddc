"""The subcommands that read results: table, plot."""

from __future__ import annotations

import argparse
from pathlib import Path

from rbtm_bench import results


def table(words: list[str]) -> int:
    """``rbtm-bench table PATH...``: runs as a table on standard output."""
    from rbtm_bench import tables

    parser = argparse.ArgumentParser(
        prog="rbtm-bench table",
        description="Runs (run folders, or folders of them) as one table. Units are in the "
        "column names; docs/metrics.md defines every metric.",
    )
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH")
    parser.add_argument("--format", "-f", choices=tables.FORMATS, default="text")
    parser.add_argument(
        "--over-seeds",
        action="store_true",
        help="a row a method: medians over the runs that differ only in their seed",
    )
    parser.add_argument("--columns", metavar="A,B", help="only these columns")
    options = parser.parse_args(words)
    runs = results.find_runs(options.paths)
    rows = results.over_seeds(runs) if options.over_seeds else results.frame(runs)
    if options.columns:
        rows = rows[tables.existing_columns(rows, options.columns)]
    print(tables.render(rows, options.format))
    return 0


def plot(words: list[str]) -> int:
    """``rbtm-bench plot PATH...``: figures beside the runs."""
    parser = argparse.ArgumentParser(
        prog="rbtm-bench plot",
        description="Figures of runs (PNG and PDF): map with trajectory and truth, standard "
        "beside rbtm, similarity matrix, gap over time.",
    )
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH")
    parser.add_argument("--out", type=Path, help="folder (default: figures/ in the first PATH)")
    options = parser.parse_args(words)
    from rbtm_bench import plots

    runs = results.find_runs(options.paths)
    for file in plots.draw(runs, options.out or options.paths[0] / "figures"):
        print(file)
    return 0
