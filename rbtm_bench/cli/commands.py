"""The command line: one subcommand a job, Hydra's overrides passed through.

Nothing heavy is imported before a subcommand needs it, so that ``--help`` answers at once.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module

from rbtm_bench.core.escape import harmless_output
from rbtm_bench.core.guarded import guarded

HELP = """\
rbtm-bench: compare scan registration backends and ways to choose the model scan.

usage: rbtm-bench COMMAND [key=value ...] [options]

commands
  data      what is at a path, and how it is read:  rbtm-bench data aces.clf.gz
  download  published logs:      rbtm-bench download aces, then dataset=aces
  run       one experiment:      rbtm-bench run backend=open3d_gicp selector=rbtm selector.window=20
  compare   a grid, one table:   rbtm-bench compare backend=none,open3d_p2p selector=previous,rbtm
  sweep     Hydra's multirun:    rbtm-bench sweep selector.threshold=0.6,0.7,0.8
  study     ways with equal tries, settings chosen elsewhere, a page:  rbtm-bench study premise
  table     runs as a table:     rbtm-bench table results/compare --against selector=previous
  show      what is behind a row: settings, command, data:  rbtm-bench show results/compare/NAME
  diff      what differs between two runs:  rbtm-bench diff RUN RUN
  plot      runs as figures:     rbtm-bench plot results/compare
  report    runs as one offline page, scan by scan:  rbtm-bench report results/compare
  gate      may a change pass?   rbtm-bench gate results/new --baseline results/main
  export    a run as csv, parquet, tum, g2o:  rbtm-bench export results/compare/NAME --to csv
  new       a plug-in of your own, begun:  rbtm-bench new selector NAME
  similarity scores of all pairs:  rbtm-bench similarity dataset.environment=l_turn --matrix
  calibrate   error against similarity, the setting to use:  rbtm-bench calibrate backend=plicp
  list      every plug-in, its parameters, and whether its library is installed
  doctor    check this installation and say what to do

what goes on the command line
  dataset=corridor|simulated|carmen|bag|...      group=member chooses a plug-in
  PATH                                          data, first of all: recognised, with dataset.path
  dataset.path=LOG selector.threshold=0.8       group.key=value sets one of its parameters
  out=DIR                                       where the results go (default: results/...)
  seed=0,1,2                                    lists make a grid (compare, sweep)

options of run, compare and sweep
  --cfg job         print the composed settings and stop
  --config-dir DIR  more plug-ins: DIR/backend/mine.yaml is backend=mine
  --debug           the whole traceback instead of one line

rbtm-bench COMMAND --help says more.   Shell completion: eval "$(rbtm-bench -sc install=bash)"
"""

HYDRA_FLAGS = (
    "--cfg",
    "-c",
    "--package",
    "-p",
    "--resolve",
    "--info",
    "-i",
    "--hydra-help",
    "--experimental-rerun",
)

SUBCOMMANDS = {
    "data": "data.data",
    "download": "download.download",
    "table": "results.table",
    "plot": "figures.plot",
    "show": "inspect.show",
    "diff": "inspect.diff",
    "gate": "publish.gate",
    "export": "publish.export",
    "report": "publish.report",
    "new": "new.new",
    "similarity": "similarity.similarity",
    "calibrate": "calibrate.calibrate",
    "study": "study.study",
    "list": "about.list_plugins",
    "doctor": "about.doctor",
}
"""Each with its module and function, which are imported when it is called."""


def main(argv: list[str] | None = None) -> int:
    """Run a subcommand; returns the exit code: 0, 1 for a failed run, 2 for a user's mistake."""
    words = list(sys.argv[1:] if argv is None else argv)
    debug = "--debug" in words or bool(os.environ.get("HYDRA_FULL_ERROR"))
    words = [word for word in words if word != "--debug"]
    with harmless_output():
        return guarded(lambda: dispatch(words), debug)


def dispatch(words: list[str]) -> int:
    """Call the subcommand's function."""
    if "-sc" in words or "--shell-completion" in words:
        from rbtm_bench.cli.completion import complete

        return complete(words)
    if not words or words[0] in ("-h", "--help", "help"):
        print(HELP, end="")
        return 0 if words else 2
    if words[0] in ("-V", "--version"):
        from rbtm_bench import __version__

        print(f"rbtm-bench {__version__}")
        return 0
    from rbtm_bench.core.errors import ConfigError

    command, *words = words
    if command in ("run", "compare", "sweep"):
        from rbtm_bench.cli import runs

        words = runs.as_words(command, words)
        if any(word in HYDRA_FLAGS or word.startswith("--cfg=") for word in words):
            return runs.hydra_itself(words)
        return {"run": runs.run, "compare": runs.compare, "sweep": runs.sweep}[command](words)
    if command in SUBCOMMANDS:
        module, _, name = SUBCOMMANDS[command].partition(".")
        function = getattr(import_module(f"rbtm_bench.cli.{module}"), name)
        return int(function(words))
    import difflib

    from rbtm_bench.cli.completion import COMMANDS

    close = difflib.get_close_matches(command, COMMANDS, n=1)
    meant = f" Did you mean {close[0]}?" if close else ""
    raise ConfigError(f"{command}: no such command.{meant} Known: {', '.join(COMMANDS)}")
