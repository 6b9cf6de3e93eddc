"""Shell completion: Hydra's own, with our subcommand taken off the line before it sees it."""

from __future__ import annotations

import os
import re
import sys

COMMANDS = ("run", "compare", "sweep", "table", "plot", "list", "doctor")
WITH_OVERRIDES = ("run", "compare", "sweep")


def complete(words: list[str]) -> int:
    """Answer ``-sc install=SHELL``, ``-sc uninstall=SHELL`` and ``-sc query=SHELL``."""
    query = next((word for word in words if word.startswith("query=")), None)
    if query is None:
        return _hydra(words)
    line = os.environ.get("COMP_LINE", "")
    match = re.match(r"\s*(?:\S*python[\d.]*\s+-m\s+)?(\S+)\s+(\S*)(\s.*)?$", line, re.DOTALL)
    if match is None:
        return 0
    program, command, rest = match.group(1), match.group(2), match.group(3)
    if rest is None:
        print(" ".join(name for name in COMMANDS if name.startswith(command)))
        return 0
    if command not in WITH_OVERRIDES:
        return 0
    os.environ["COMP_LINE"] = f"{program}{rest}"
    point = int(os.environ.get("COMP_POINT", len(line)))
    os.environ["COMP_POINT"] = str(max(0, point - (len(line) - len(program) - len(rest))))
    return _hydra(["-sc", query])


def _hydra(words: list[str]) -> int:
    from rbtm_bench.cli_runs import hydra_main

    sys.argv[0] = "rbtm-bench"
    hydra_main(words, lambda cfg: None)
    return 0
