"""The subcommands that hand results on: gate (to a pull request), export (to other programs),
report (to a reader, as a page)."""

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


REPORT = """\
examples
  rbtm-bench report results/compare                      writes results/compare/report.html
  rbtm-bench report results/a results/b out=both.html    two sweeps as one
  rbtm-bench report results/sweep --serve                a page that follows a running sweep

The file opens without a network: docs/report.md says what it shows, and what it leaves out."""


def report(words: list[str]) -> int:
    """``rbtm-bench report PATH...``."""
    parser = argparse.ArgumentParser(
        prog="rbtm-bench report",
        description="Runs, a comparison or a sweep as one HTML file that needs no network: the "
        "answer, the\ntable, accuracy against cost, paths and maps over each other, every scan "
        "with its choice.",
        epilog=REPORT,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        usage="rbtm-bench report PATH... [out=FILE] [--serve [PORT]]",
    )
    parser.add_argument("paths", nargs="+", metavar="PATH")
    parser.add_argument("--out", metavar="FILE", help="default: report.html in the first PATH")
    parser.add_argument(
        "--serve",
        nargs="?",
        type=int,
        const=0,
        metavar="PORT",
        help="on this machine alone (127.0.0.1), made again when a run has ended; writes no file",
    )
    parser.add_argument(
        "--trust",
        action="store_true",
        help="run code outside rbtm_bench that the runs' settings name, to read scans again",
    )
    options = parser.parse_args([f"--{w}" if w.startswith("out=") else w for w in words])
    from rbtm_bench.page import assemble

    paths = [Path(path) for path in options.paths]
    if options.serve is not None:
        return _serve(paths, options)
    out = Path(options.out) if options.out else paths[0] / "report.html"
    if out.is_dir():
        raise ConfigError(f"out={out}: is a folder: expected a file such as {out}/report.html")
    for note in assemble.write(paths, out, options.trust):
        print(f"note: {note}")
    print(f"{out}   ({out.stat().st_size / 1e6:.1f} MB)")
    return 0


def _serve(paths: list[Path], options: argparse.Namespace) -> int:
    from rbtm_bench.page import serve
    from rbtm_bench.runs import stored

    if options.out:
        raise ConfigError("--serve: writes no file: leave out= out")
    stored.find_runs(paths)  # a path without runs is a mistake to be told now
    with serve.server(serve.LivePage(paths, options.trust), options.serve) as server:
        print(f"http://{serve.HOST}:{serve.port_of(server)}/   (Ctrl-C ends it)", flush=True)
        server.serve_forever()
    return 0
