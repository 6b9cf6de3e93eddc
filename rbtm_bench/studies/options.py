"""The command line that the studies on logs share."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from rbtm_bench.engine import drive

DATA = "RBTM_BENCH_DATA"


def make_parser(description: str | None, out: Path, pages: str) -> argparse.ArgumentParser:
    """A parser with the options of every study; ``pages`` are what --reference leaves."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=out, help=f"folder (default {out})")
    parser.add_argument("--data", "--logs", type=Path, metavar="FOLDER", help=f"instead of {DATA}")
    parser.add_argument("--backends", metavar="A,B", help="these planar backends only")
    parser.add_argument("--jobs", "-j", type=int, default=drive.default_jobs())
    parser.add_argument("--fresh", action="store_true", help="keep nothing of an earlier call")
    parser.add_argument("--reference", type=Path, metavar="FOLDER", help=f"leave {pages} there too")
    parser.add_argument("--debug", action="store_true", help="errors with their whole traceback")
    return parser


def data_folder(options: argparse.Namespace) -> Path | None:
    """Where the logs are: --data, or else the environment's; None if neither says."""
    named = options.data or os.environ.get(DATA)
    return Path(named) if named else None
