"""The subcommand that makes figures of results: plot."""

from __future__ import annotations

import argparse
from pathlib import Path

from rbtm_bench.cli.results import warn
from rbtm_bench.runs import stored


def plot(words: list[str]) -> int:
    """``rbtm-bench plot PATH...``: figures beside the runs."""
    parser = argparse.ArgumentParser(
        prog="rbtm-bench plot",
        description="Figures of runs (PNG, PDF, SVG): map and occupancy grid with trajectory and "
        "truth, standard beside rbtm, similarity matrix, gap over time; of methods side by side "
        "their paths, error over the path, error by method with its spread, accuracy "
        "against time with the Pareto front; of a sweep heat maps of the error over threshold "
        "and window. Only what makes sense for the runs (docs/figures.md). Several sweeps are "
        "merged.",
    )
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH")
    parser.add_argument("--out", type=Path, help="folder (default: figures/ in the first PATH)")
    _add_drawing(parser)
    options = parser.parse_args(words)
    from rbtm_bench import plots
    from rbtm_bench.plots.style import Drawing
    from rbtm_bench.report.names import Names

    runs = stored.find_runs(options.paths)
    warn(runs)
    drawing = Drawing(
        options.style, not options.no_titles, options.format or ("png", "pdf"),
        Names.read(options.names),
    )  # fmt: skip
    out = options.out or options.paths[0] / "figures"
    for file in plots.draw(runs, out, options.only or (), drawing):
        print(file)
    return 0


def _add_drawing(parser: argparse.ArgumentParser) -> None:
    """Options of how figures are drawn."""
    parser.add_argument(
        "--only", action="append", metavar="NAME",
        help="this figure (errors, trajectories, accuracy_time, ...: docs/figures.md); repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--style", choices=("paper", "talk"), default="paper",
        help="letters of 8 points in a column's width, or larger ones and thicker lines",
    )  # fmt: skip
    parser.add_argument("--no-titles", action="store_true", help="the caption says it")
    parser.add_argument(
        "--format", action="append", choices=("png", "pdf", "svg"),
        help="repeatable (default: png and pdf)",
    )  # fmt: skip
    parser.add_argument("--names", type=Path, metavar="FILE", help="a YAML of names over ours")
