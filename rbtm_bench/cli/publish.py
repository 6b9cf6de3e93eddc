"""The subcommands that hand results on: gate (to a pull request), export (to other programs)."""

from __future__ import annotations

import argparse
from pathlib import Path

from rbtm_bench.core.errors import ConfigError

GATE = """\
examples
  rbtm-bench gate results/new --max relations_translation_mean_m=.2 --min coverage=.9
  rbtm-bench gate results/new --baseline results/main --filter "backend != 'none'"

Limits hold for every method's medians over seeds and replicates; a failed run fails the gate.
--baseline compares every method with itself there. Only what docs/statistics.md calls worse is a
regression: over replicates (compare replicates=10) or six data sets, never by one run.
Exit code: 0 passed, 1 failed, 2 a mistake in what was asked."""


def gate(words: list[str]) -> int:
    """``rbtm-bench gate PATH...``: 0 if all that is asked holds, 1 if not."""
    parser = argparse.ArgumentParser(
        prog="rbtm-bench gate",
        description="Hold runs against limits and against runs of before; prints one comment for a "
        "pull\nrequest, in Markdown.",
        epilog=GATE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        usage="rbtm-bench gate PATH... [options]",
    )
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH")
    for name, what in (("max", "no method may be above"), ("min", "no method may be below")):
        parser.add_argument(
            f"--{name}", action="append", default=[], metavar="KEY=NUMBER", help=f"{what} this"
        )
    parser.add_argument("--baseline", type=Path, metavar="DIR", help="runs of before")
    parser.add_argument(
        "--metric", metavar="A,B", help="with --baseline: by these, not by the main error"
    )
    parser.add_argument(
        "--filter", metavar="EXPR", help="only these methods: pandas' query, as of table"
    )
    options = parser.parse_args(words)
    from rbtm_bench.report import frame
    from rbtm_bench.report import gate as gates
    from rbtm_bench.runs import stored

    if options.metric and not options.baseline:
        raise ConfigError("--metric: goes with --baseline")
    most, least = gates.limits(options.max, "--max"), gates.limits(options.min, "--min")
    methods = frame.methods(stored.find_runs(options.paths))
    if options.filter:
        kept = frame.filtered(frame.table_of(methods), options.filter).index
        methods = [methods[i] for i in sorted(kept)]
    findings = gates.within(methods, most, least)
    notes: list[str] = []
    if options.baseline:
        keys = [key.strip() for key in (options.metric or "").split(",") if key.strip()]
        before = frame.methods(stored.find_runs([options.baseline]))
        compared, notes = gates.regressions(methods, before, keys)
        findings += compared
    elif not most and not least and not findings:
        raise ConfigError("nothing is asked: expected --max, --min or --baseline")
    print(gates.comment(findings, notes))
    return int(any(finding.outcome == gates.FAILED for finding in findings))


def export(words: list[str]) -> int:
    """``rbtm-bench export RUN --to FORMAT``."""
    parser = argparse.ArgumentParser(
        prog="rbtm-bench export",
        description="A run for other programs: csv and parquet have a row a scan (stamp, pose and "
        "how it got it: docs/metrics.md), tum has the trajectory alone (evo), g2o the pose graph "
        "of a run that closed loops.",
        epilog="example: rbtm-bench export results/compare/none-rbtm-seed=0 --to csv",
    )
    parser.add_argument("run", type=Path, metavar="RUN", help="a run's folder")
    parser.add_argument("--to", required=True, choices=("csv", "parquet", "tum", "g2o"))
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="default: the run's name, in this folder"
    )
    options = parser.parse_args(words)
    from rbtm_bench.report import export as exports
    from rbtm_bench.report import inspection

    run = inspection.find_run(options.run)
    out = options.out or Path(f"{run.path.resolve().name}.{options.to}")
    exports.export(run, options.to, out)
    print(out)
    return 0
