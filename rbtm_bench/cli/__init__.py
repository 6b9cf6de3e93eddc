"""The command line: ``rbtm-bench COMMAND``."""

from rbtm_bench.cli.commands import main

__all__ = ["main"]
