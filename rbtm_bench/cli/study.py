"""The subcommand that conducts studies."""

from __future__ import annotations

import argparse
from pathlib import Path

from rbtm_bench.core.errors import ConfigError

HELP = """\
A study: ways to choose the model scan, with the same number of tries each, settings chosen on
other data than those shown, and a page of tables and figures (docs/studies.md).

examples
  rbtm-bench study                     the studies there are
  rbtm-bench study premise --quick     a small one of it, to see that it runs
  rbtm-bench study mine.yaml --jobs 2
  rbtm-bench study results/studies/premise         goes on with one that was cut

OUT (default results/studies/NAME) holds README.md, table.csv, ratios.csv, figures and runs/."""


def study(words: list[str]) -> int:
    """``rbtm-bench study NAME|FILE.yaml``."""
    parser = argparse.ArgumentParser(
        prog="rbtm-bench study",
        description=HELP,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        usage="rbtm-bench study NAME|FILE.yaml [key=value ...] [options]",
        allow_abbrev=False,
    )
    parser.add_argument("name", nargs="?", help="a study's name, file, or begun folder")
    parser.add_argument("overrides", nargs="*", metavar="key=value", help="for all of its runs")
    parser.add_argument("--out", type=Path, metavar="DIR")
    parser.add_argument("--jobs", "-j", type=int, metavar="N", help="runs side by side")
    parser.add_argument("--quick", action="store_true", help="what the file's quick says instead")
    parser.add_argument(
        "--reference", type=Path, metavar="DIR", help="leave the page there too, to be committed"
    )
    options = parser.parse_intermixed_args(words)
    from rbtm_bench.studies import study_file

    if options.name is None:
        for name in study_file.names():
            print(f"{name:<12} {study_file.load(name, False, []).title}")
        return 0
    from rbtm_bench.engine import drive
    from rbtm_bench.engine.sweep_folder import Asked
    from rbtm_bench.studies import page, runner

    jobs = options.jobs if options.jobs is not None else drive.default_jobs()
    if jobs < 1:
        raise ConfigError(f"--jobs {jobs}: expected at least 1")
    for word in options.overrides:
        if word.find("=") < 1:
            raise ConfigError(f"{word}: expected key=value")
    one = study_file.load(options.name, options.quick, options.overrides)
    begun = Path(options.name).is_dir()
    stem = Path(options.name).stem + ("-quick" if options.quick else "")
    out = options.out or (Path(options.name) if begun else Path("results/studies") / stem)
    typed = [options.name, *options.overrides, *(["--quick"] if options.quick else [])]
    asked = Asked.now("study", typed, options.overrides, [], False)
    outcome = runner.conduct(one, asked, out, jobs)
    if options.reference:
        page.leave(out, options.reference, stem)
    print((out / page.PAGE).read_text(encoding="utf-8"), end="")
    print(f"\n{out / page.PAGE}")
    return 1 if outcome.failed else 0
