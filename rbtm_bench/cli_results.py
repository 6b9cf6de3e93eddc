"""The subcommands that read results: table, plot."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rbtm_bench import results
from rbtm_bench.results import Run

if TYPE_CHECKING:
    import pandas as pd


def table(words: list[str]) -> int:
    """``rbtm-bench table PATH...``: runs as a table on standard output."""
    from rbtm_bench import tables

    parser = argparse.ArgumentParser(
        prog="rbtm-bench table",
        description="Runs (run folders, or folders of them: several sweeps and comparisons too) "
        "as one table. Units are in the column names; docs/metrics.md defines every metric. What "
        "makes rows hard to compare (other data, other versions) is said on standard error.",
    )
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH")
    parser.add_argument("--format", "-f", choices=tables.FORMATS, default="text")
    parser.add_argument(
        "--over-seeds",
        action="store_true",
        help="a row a method: medians over the runs that differ only in their seed",
    )
    parser.add_argument(
        "--best",
        action="store_true",
        help="the best setting of every data set, backend and selector (medians over seeds), "
        "with the number of settings that each was the best of",
    )
    parser.add_argument("--columns", metavar="A,B", help="only these columns")
    options = parser.parse_args(words)
    runs = results.find_runs(options.paths)
    _warn(runs)
    if options.best:
        _print_best(tables.best(results.over_seeds(runs)), options.format, options.columns)
        return 0
    rows = results.over_seeds(runs) if options.over_seeds else results.frame(runs)
    if options.columns:
        rows = rows[tables.existing_columns(rows, options.columns)]
    print(tables.render(rows, options.format))
    return 0


def _print_best(best: pd.DataFrame, fmt: str, columns: str | None) -> None:
    """The table of best settings: whole as CSV and JSON, else the columns that matter. What must
    be said with it goes below, or to standard error where that would not be a table any more."""
    from rbtm_bench import summary, tables

    if fmt == "text" and not columns:
        print("\n".join(summary.of_best(best)))
        return
    rows = best
    if columns:
        rows = best[tables.existing_columns(best, columns)]
    elif fmt not in ("csv", "json"):
        rows = best[tables.best_columns(best)[0]]
    print(tables.render(rows, fmt))
    for line in tables.chances(best):
        print(line, file=sys.stdout if fmt == "text" else sys.stderr)


def _warn(runs: Sequence[Run]) -> None:
    """Say on standard error what makes the runs hard to compare."""
    from rbtm_bench import summary

    for line in summary.differences(runs):
        print(f"warning: {line}", file=sys.stderr)


def plot(words: list[str]) -> int:
    """``rbtm-bench plot PATH...``: figures beside the runs."""
    parser = argparse.ArgumentParser(
        prog="rbtm-bench plot",
        description="Figures of runs (PNG and PDF): map with trajectory and truth, standard "
        "beside rbtm, similarity matrix, gap over time; of a sweep the error of every method and "
        "heat maps of the error over threshold and window. Several sweeps are merged.",
    )
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH")
    parser.add_argument("--out", type=Path, help="folder (default: figures/ in the first PATH)")
    options = parser.parse_args(words)
    from rbtm_bench import plots

    runs = results.find_runs(options.paths)
    _warn(runs)
    for file in plots.draw(runs, options.out or options.paths[0] / "figures"):
        print(file)
    return 0
