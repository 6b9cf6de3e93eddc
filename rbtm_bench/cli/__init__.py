"""The command line: ``rbtm-bench COMMAND``."""

from __future__ import annotations

import sys
from typing import NoReturn

from rbtm_bench.core import process

SHORT = ("run", "compare", "sweep", "list", "doctor")
"""Commands that do no long work in this process before ``process.settle``."""


def main() -> NoReturn:
    """The program: one command, and the end of its process."""
    from rbtm_bench.cli.commands import main as command

    if sys.argv[1:2] and sys.argv[1] not in SHORT:
        sys.exit(command())
    process.begin()
    process.end(command())
