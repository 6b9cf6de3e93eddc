"""The subcommand that looks at data: what they are and how they are read."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from rbtm_bench.core.errors import ConfigError


def data(words: list[str]) -> int:
    """``rbtm-bench data PATH``."""
    parser = argparse.ArgumentParser(
        prog="rbtm-bench data",
        description="What is at a path, and how it is read: scans, times, ranges, what is left\n"
        "out, odometry and truth with their roles, and what looks wrong.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        usage="rbtm-bench data PATH [dataset.key=value ...] [options]",
        epilog="example: rbtm-bench data aces.clf.gz dataset.relations=aces.relations\n"
        "Without a path: the data set that dataset= chooses.",
        allow_abbrev=False,
    )
    parser.add_argument("--all", action="store_true", help="look at every scan, not at 200")
    parser.add_argument("--config-dir", "-cd", action="append", default=[], metavar="DIR")
    options, rest = parser.parse_known_args(words)
    unknown = [word for word in rest if word.startswith("-")]
    if unknown:
        raise ConfigError(f"{unknown[0]}: no such option; see rbtm-bench data --help")
    from rbtm_bench.runs.words import as_typed, with_data

    if not rest:
        raise ConfigError("data: expected a path, or dataset=")
    if "=" not in rest[0] or os.path.exists(rest[0]):
        rest = with_data(rest)
    strangers = [word for word in rest if word.find("=") < 1]
    if strangers:
        raise ConfigError(f"{strangers[0]}: expected key=value")
    from rbtm_bench.datasets import summary
    from rbtm_bench.runs import assembly
    from rbtm_bench.runs.settings import compose_settings

    settings = compose_settings(as_typed(rest), tuple(map(Path, options.config_dir)))
    dataset = assembly.build(settings.config["dataset"])
    chosen = {k: v for k, v in settings.config["dataset"].items() if k in ("path", "sequence")}
    place = ", ".join(str(value) for value in chosen.values())
    print(f"{settings.choices['dataset']}: {place or 'simulated'}")
    print("\n".join(summary.report(dataset, options.all)))
    return 0
