"""The subcommand that makes tables of results: table."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.report import frame
from rbtm_bench.report.frame import MethodRuns
from rbtm_bench.report.replicates import SHIFTED
from rbtm_bench.runs import stored
from rbtm_bench.runs.stored import Run

if TYPE_CHECKING:
    import pandas as pd

    from rbtm_bench.report.intervals import Statistic

TABLE = """\
examples
  rbtm-bench table results/compare --over-seeds -f latex        a row a method, for a paper
  rbtm-bench table results/s1 results/s2 --best                 two sweeps as one
  rbtm-bench table results/compare --intervals                  how sure is each number
  rbtm-bench table results/compare --against selector=previous  is it better than the standard
  rbtm-bench table results/compare --against "keyframe distance=0.3" --metric ape_rmse_m
  rbtm-bench table results/bare results/paper --against previous --pool
  rbtm-bench table results/aces results/intel results/csail --held-out
  rbtm-bench table results/sweep --choose-on seed=100,101,102 --against previous

Intervals are bootstrapped over independent data sets: the seeds of a simulated environment; one
log is one data set, and its relations are resampled by the place and time they belong to.
--against compares on the same seeds (or relations), within a backend for a selector and within a
selector for a backend; better and worse stand only where six data sets or more agree enough.
--held-out and --choose-on show settings on other data than those that chose them: for every
data set, backend and selector the setting with the least mean logarithm of the main error on the
choosing data (a ratio counts the same on every data set); one with a failed run only where
all have one; of equal ones the first. With --intervals or --against: of these rows.
docs/statistics.md says how, docs/metrics.md defines every metric."""


def table(words: list[str]) -> int:
    """``rbtm-bench table PATH...``: runs as a table on standard output."""
    from rbtm_bench.report import answer, best_settings, render
    from rbtm_bench.report.replicates import number_of

    options = _table_parser().parse_args(words)
    if options.metric and not (options.intervals or options.against or options.paper):
        raise ConfigError("--metric: goes with --intervals, --against, --paper; else --columns")
    if options.pool and not (options.intervals or options.against):
        raise ConfigError("--pool: goes with --intervals or --against")
    if options.mean and not options.intervals:
        raise ConfigError("--mean: goes with --intervals")
    if (options.sort or options.filter) and (
        options.intervals or options.against or options.held_out or options.choose_on
    ):
        raise ConfigError("--sort, --filter: go with a row a run, --over-seeds or --best")
    choice = "--held-out" if options.held_out else "--choose-on" if options.choose_on else ""
    if choice and (options.best or options.over_seeds):
        raise ConfigError(f"{choice}: goes with --intervals or --against, or alone")
    runs = stored.find_runs(options.paths)
    warn(runs)
    chosen = _choose(runs, options) if choice else None
    if options.paper:
        print(_paper(chosen or frame.methods(runs), options))
        return 0
    if options.intervals or options.against:
        _print_statistics(runs, options, chosen)
        return 0
    if chosen is not None:
        _print_chosen(chosen, options.format, options.columns)
        return 0
    if options.best:
        best = _arranged(best_settings.best(frame.over_seeds(runs)), options)
        _print_best(best, options.format, options.columns)
        if options.format == "text":
            print("\n".join(["", *answer.answer(frame.methods(runs), _places(options))]))
        return 0
    as_text = options.format == "text"
    has_copies = any(map(number_of, runs))  # a row a method, as "better" is said of
    by_method = options.over_seeds or (as_text and has_copies)
    rows = frame.over_seeds(runs) if by_method else frame.frame(runs)
    rows = _arranged(rows, options)
    if as_text:
        _print_rows(runs, rows, by_method, options)
        return 0
    print(render.render(_columns(rows, options.columns)[0], options.format))
    return 0


def _paper(methods: Sequence[MethodRuns], options: argparse.Namespace) -> str:
    """The pivot of --paper. Raises ``ConfigError`` for what does not go with it."""
    from rbtm_bench.report import typeset
    from rbtm_bench.report.names import Names
    from rbtm_bench.report.pivot import pivot
    from rbtm_bench.report.with_intervals import named_metrics

    fmt = "latex" if options.format == "text" else options.format
    unfit = ("intervals", "against", "best", "over_seeds", "sort", "filter", "pool", "mean")
    others = [f"--{name.replace('_', '-')}" for name in unfit if getattr(options, name)]
    if others or fmt not in typeset.FORMATS:
        what = others[0] if others else f"--format {fmt}"
        raise ConfigError(f"{what}: does not go with --paper (latex, html or md)")
    metrics = named_metrics([run for method in methods for run in method.runs], options.metric)
    names = Names.read(options.names)
    table = pivot(methods, options.rows, options.columns or "selector", metrics, names)
    return typeset.typeset(table, fmt, not options.no_spread)


def _print_rows(
    runs: Sequence[Run], rows: pd.DataFrame, by_method: bool, options: argparse.Namespace
) -> None:
    """The table as text, and the answer of the rows that are in it."""
    from rbtm_bench.report import answer, best_settings, render, screen

    kept = sorted(rows.index)
    methods = frame.methods(runs) if by_method else frame.methods([runs[i] for i in kept])
    methods = [methods[i] for i in kept] if by_method else methods
    shown = rows if by_method else _without_rotations(rows)
    if by_method and not options.columns:
        lines = screen.with_same(shown, render.SHORT, render.ALWAYS)
    else:
        keep = ["run", *render.ALWAYS, *best_settings.main_errors(rows)]
        lines = render.fitted(*_columns(shown, options.columns, keep))
    if len(shown) < len(rows):
        lines.append(f"{len(rows) - len(shown)} runs of {SHIFTED} are one row of --over-seeds")
    print("\n".join([*lines, "", *answer.answer(methods, _places(options))]))


def _without_rotations(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows without those of one rotation each, unless there are no others."""
    others = rows[rows["selector"] != SHIFTED]
    return rows if others.empty else others


def _places(options: argparse.Namespace) -> str:
    return shlex.join(map(str, options.paths))


def _arranged(rows: pd.DataFrame, options: argparse.Namespace) -> pd.DataFrame:
    """The rows that --filter keeps, by --sort; as text by their main error, if nothing else is
    asked for. Raises ``ConfigError`` for an expression that pandas cannot answer."""
    from rbtm_bench.report import best_settings

    if options.filter:
        rows = frame.filtered(rows, options.filter)
    ranked = options.format == "text" and not options.columns and "data" in rows
    rows = best_settings.ranked(rows) if ranked else rows
    if options.sort:
        if options.sort not in rows:
            raise ConfigError(f"--sort {options.sort}: no such column. Known: {', '.join(rows)}")
        rows = rows.sort_values(options.sort, kind="stable", na_position="last")
    return rows


def _columns(
    rows: pd.DataFrame, names: str | None, keep: Sequence[str] = ()
) -> tuple[pd.DataFrame, Sequence[str]]:
    """The named columns, all of which are to be kept; else the rows as they are."""
    from rbtm_bench.report import render

    if not names:
        return rows, keep
    shown = render.existing_columns(rows, names)
    return rows[shown], shown


def _add_choice(parser: argparse.ArgumentParser) -> None:
    """Options that choose settings on other data than are shown."""
    choice = parser.add_mutually_exclusive_group()
    choice.add_argument(
        "--held-out",
        action="store_true",
        help="for every data set, backend and selector the setting that did best on the other "
        "data sets",
    )
    choice.add_argument(
        "--choose-on",
        metavar="KEY=VALUES",
        help="the same with settings chosen on the runs with these values (seed=100,101,102, "
        "dataset.environment=paper), and the others shown",
    )


def _table_parser() -> argparse.ArgumentParser:
    from rbtm_bench.report import render

    parser = argparse.ArgumentParser(
        prog="rbtm-bench table",
        description="Runs (run folders, or folders of them: several sweeps and comparisons too) "
        "as one table.\nUnits are in the column names. What makes rows hard to compare (other "
        "data, other versions)\nis on standard error. rbtm-bench show RUN tells what is "
        "behind a row.",
        epilog=TABLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH")
    alias = {"markdown": "md"}
    parser.add_argument(
        "--format", "-f", type=lambda word: alias.get(word, word), choices=render.FORMATS,
        default="text",
    )  # fmt: skip
    _add_paper(parser)
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument(
        "--over-seeds",
        action="store_true",
        help="a row a method: medians over the runs that differ only in their seed",
    )
    kind.add_argument(
        "--best",
        action="store_true",
        help="the best setting of every data set, backend and selector (medians over seeds), "
        "with the number of settings that each was the best of",
    )
    kind.add_argument(
        "--intervals",
        action="store_true",
        help="a row a method: medians over seeds with bootstrap 95%% intervals",
    )
    kind.add_argument(
        "--against",
        metavar="METHOD",
        help="a row a method: paired differences from this one, with intervals and tests",
    )
    _add_choice(parser)
    _add_statistics(parser)
    parser.add_argument("--columns", metavar="A,B", help="only these columns")
    parser.add_argument(
        "--sort",
        metavar="COLUMN",
        help="rows by this one, the smallest first (else, as text, by "
        "the main error, the winner marked)",
    )
    parser.add_argument(
        "--filter",
        metavar="EXPR",
        help="only these rows: pandas' query, such as \"backend == 'plicp' and window > 4\"",
    )
    return parser


def _add_statistics(parser: argparse.ArgumentParser) -> None:
    """Options of tables with intervals and tests."""
    parser.add_argument(
        "--metric", metavar="A,B", help="with --intervals, --against: these, not the main error"
    )
    parser.add_argument(
        "--pool",
        action="store_true",
        help="with --intervals, --against: all data sets together (seeds x environments, or logs)",
    )
    parser.add_argument("--mean", action="store_true", help="with --intervals: not the median")


def _add_paper(parser: argparse.ArgumentParser) -> None:
    """Options of the table for a paper."""
    parser.add_argument(
        "--paper",
        action="store_true",
        help="one number over two axes, best and ties marked, with its caption: LaTeX for \\input "
        "(booktabs, siunitx), or -f html, -f md; --metric A: not the main error",
    )
    parser.add_argument(
        "--rows", metavar="AXIS", default="backend",
        help="with --paper: a group, GROUP.SETTING, settings, data or metric (default: backend; "
        "--columns: selector)",
    )  # fmt: skip
    parser.add_argument(
        "--names", type=Path, metavar="FILE", help="with --paper: a YAML of names over ours"
    )
    parser.add_argument("--no-spread", action="store_true", help="with --paper: no quartiles")


def _choose(runs: Sequence[Run], options: argparse.Namespace) -> list[MethodRuns]:
    """The rows that --held-out or --choose-on asks for."""
    from rbtm_bench.report import held_out

    if options.held_out:
        return held_out.leave_one_out(runs)
    return held_out.choose_on(runs, *held_out.parse(options.choose_on))


def _print_chosen(chosen: Sequence[MethodRuns], fmt: str, columns: str | None) -> None:
    """The table of settings chosen elsewhere: whole as CSV and JSON, else the columns that
    matter."""
    from rbtm_bench.report import held_out, render

    rows, notes = held_out.chosen_table(chosen), held_out.choice_notes(chosen)
    names, main = held_out.chosen_columns(rows)
    if columns:
        rows = rows[render.existing_columns(rows, columns)]
    elif fmt == "text":
        keep = (*render.ALWAYS, *main)
        rows, same = render.screen_table(rows, names, keep)
        notes = [f"the same in every row: {same}", *notes] if same else notes
        print("\n".join(render.fitted(rows, keep)))
        return _say(notes, fmt)
    elif fmt not in ("csv", "json"):
        rows = rows[names]
    print(render.render(rows, fmt))
    return _say(notes, fmt)


def _print_statistics(
    runs: Sequence[Run], options: argparse.Namespace, chosen: Sequence[MethodRuns] | None
) -> None:
    """A table of intervals or differences: numbers as CSV and JSON, else folded to be read."""
    from rbtm_bench.report import held_out, paired, render, with_intervals

    metrics = with_intervals.named_metrics(runs, options.metric)
    methods = held_out.pooled(chosen) if chosen and options.pool else chosen
    if options.against:
        rows = paired.against(runs, options.against, metrics, options.pool, methods)
        notes = paired.difference_notes(rows)
    else:
        statistic: Statistic = "mean" if options.mean else "median"
        rows = with_intervals.interval_table(runs, metrics, statistic, options.pool, methods)
        notes = with_intervals.interval_notes(rows, statistic)
    notes += held_out.choice_notes(chosen) if chosen else []
    if options.format not in ("csv", "json"):
        rows = with_intervals.folded(rows)
    if options.columns:
        rows = rows[render.existing_columns(rows, options.columns)]
    elif options.format == "text":
        descriptive = [*frame.METHOD, "seeds", "status", "unit", "reference", "reference_status"]
        descriptive += ["metric", *held_out.CHOICE_COLUMNS]
        numbers = [c for c in rows if c not in descriptive]
        rows, same = render.screen_table(rows, list(rows), [*render.ALWAYS, *numbers])
        notes = [f"the same in every row: {same}", *notes] if same else notes
        apart = "ratio" if "ratio" in rows and rows["ratio"].notna().any() else "difference"
        keep = [*render.ALWAYS, "settings", "holds", "p_holm", apart, *numbers[:1]]
        keep += ["metric"] if "metric" in rows and rows["metric"].nunique() > 1 else []
        print("\n".join(render.fitted(rows, keep)))
        return _say(notes, options.format)
    print(render.render(rows, options.format))
    return _say(notes, options.format)


def _print_best(best: pd.DataFrame, fmt: str, columns: str | None) -> None:
    """The table of best settings: whole as CSV and JSON, else the columns that matter."""
    from rbtm_bench.report import best_settings, render, screen

    if fmt == "text" and not columns:
        print("\n".join(screen.of_best(best)))
        return
    rows = best
    if columns:
        rows = best[render.existing_columns(best, columns)]
    elif fmt not in ("csv", "json"):
        rows = best[best_settings.best_columns(best)[0]]
    print(render.render(rows, fmt))
    _say(best_settings.chances(best), fmt)


def _say(lines: Sequence[str], fmt: str) -> None:
    """Print the notes of a table: below it, or on standard error where that would not be a
    table any more."""
    from rbtm_bench.report import render

    if fmt == "text":
        print("\n".join(render.in_width(lines)))
        return
    for line in lines:
        print(line, file=sys.stderr)


def warn(runs: Sequence[Run]) -> None:
    """Print on standard error what makes the runs hard to compare."""
    from rbtm_bench.report import screen

    for line in screen.comparison_warnings(runs):
        print(f"warning: {line}", file=sys.stderr)
