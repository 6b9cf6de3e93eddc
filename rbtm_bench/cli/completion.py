"""Shell completion: Hydra's own, with our subcommand taken off the line before it sees it."""

from __future__ import annotations

import contextlib
import os
import re
import sys

COMMANDS = (
    "run",
    "compare",
    "sweep",
    "table",
    "show",
    "diff",
    "plot",
    "report",
    "gate",
    "export",
    "new",
    "similarity",
    "calibrate",
    "study",
    "data",
    "download",
    "list",
    "doctor",
)
WITH_OVERRIDES = ("data", "run", "compare", "sweep", "similarity", "calibrate")


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
    # of a list only the first value: Hydra composes one config to know its keys
    rest = re.sub(r"(\s[\w./]+=[^\s,'\"({\[]+),[^\s'\"({\[]+(?=\s)", r"\1", rest)
    os.environ["COMP_LINE"] = f"{program}{rest}"
    os.environ["COMP_POINT"] = str(len(os.environ["COMP_LINE"]))
    # half a line often cannot be composed: then nothing is suggested, without noise either
    with (
        open(os.devnull, "w") as nowhere,
        contextlib.redirect_stderr(nowhere),
        contextlib.suppress(Exception, SystemExit),
    ):
        _hydra(["-sc", query])
    return 0


def _hydra(words: list[str]) -> int:
    from rbtm_bench.runs.settings import hydra_main

    sys.argv[0] = "rbtm-bench"
    hydra_main(words, lambda cfg: None)
    return 0
