"""Whatever a command raises becomes one line and an exit code."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

from rbtm_bench.core.errors import RbtmBenchError


def _exit_code(call: Callable[[], int]) -> int:
    """What ``call`` returns; argparse leaves by an exception after help (0) or a mistake (2)."""
    try:
        return call()
    except SystemExit as leave:
        return leave.code if isinstance(leave.code, int) else 0


def guarded(call: Callable[[], int], debug: bool) -> int:
    """The exit code of ``call``; errors print one line, with ``debug`` the whole traceback."""
    try:
        code = _exit_code(call)
        if sys.stdout is not None:  # None: started with standard output closed
            sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        print("rbtm-bench: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader has seen enough; nothing to flush at exit either
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        known = isinstance(error, RbtmBenchError)
        if debug:
            import traceback

            traceback.print_exc()
        else:
            text = " ".join(str(error).split())
            where = "" if known else " (--debug shows where)"
            name = "" if known else f"{type(error).__name__}: "
            print(f"rbtm-bench: {name}{text}{where}", file=sys.stderr)
        return error.exit_code if isinstance(error, RbtmBenchError) else 1
