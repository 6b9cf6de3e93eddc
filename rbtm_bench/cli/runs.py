"""The subcommands that run things: run, compare, sweep."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

from rbtm_bench.core import process
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.engine.progress import bar

RUN_HELP = """\
One experiment: a data set, a backend, a selector; a folder of results and a summary.

examples
  rbtm-bench run                                                   the embedded corridor
  rbtm-bench run backend=open3d_gicp selector=previous seed=3
  rbtm-bench run aces.clf.gz backend=open3d_p2plane                the data are recognised
  rbtm-bench run dataset=carmen dataset.path=aces.clf.gz dataset.relations=aces.relations
  rbtm-bench run dataset=cloud_folder dataset.path=clouds similarity=virtual_scan

The folder (out=DIR) holds config.yaml, run.json, steps.parquet (a row a scan), trajectory.tum,
metrics.json, map.npz and, on data with relations, relations.parquet. An existing one is refused
unless overwrite=true. time_limit=SECONDS ends a run that takes longer, memory_limit=MB one that
has more memory resident.
On logs and clouds selector.threshold=auto is the default: the highest threshold that decides, in
the data's first part, nearly as many scans as any does; and keyframes are a tenth of the median
range apart (docs/selection.md). run.json and the tables have the numbers.
rbtm-bench list shows the choices; --cfg job prints the composed settings."""

COMPARE_HELP = """\
A grid of experiments, one table. Comma lists multiply; a key such as selector.window applies to
every chosen member that has it, and points that coincide are merged.

examples
  rbtm-bench compare backend=none,open3d_p2p selector=previous,keyframe,rbtm selector.window=10
  rbtm-bench compare selector=rbtm,random_gap selector.threshold=0.6,0.8 seed=0,1,2,3,4
  rbtm-bench compare backend=open3d_p2p,plicp selector=previous,rbtm replicates=10

selector=random_gap draws its gaps from the comparison's own rbtm run. A grid with rbtm gets its
controls by itself, matched to rbtm's runs: previous, oldest, keyframe, fixed_gap and 19 rotations
of rbtm's own gaps (docs/statistics.md); controls=none leaves them out.
The folder (out=DIR) holds a run folder for every point, table.csv (a row a run) and summary.csv
(a row a method, medians over seeds). replicates=N runs every point on N perturbed copies of the
data as well: what "better" takes on a log (docs/statistics.md).

A run that raises, kills its process, takes longer than time_limit=SECONDS or more memory than
memory_limit=MB (default null: no limit) is a row marked failed, with its reason; the others go on,
and the exit code is 1. With --fail-fast nothing new is started after the first failure.

Stopped by Ctrl-C, a crash or a reboot? rbtm-bench compare --resume DIR does what is missing."""

SWEEP_HELP = """\
Hydra's multirun: every combination of the comma lists, with Hydra's own launchers.

example
  rbtm-bench sweep backend=open3d_p2p,kiss_icp selector.threshold=0.6,0.7 hydra/launcher=joblib

out=DIR is the folder of the sweep; its runs are DIR/0, DIR/1, ... and the controls of rbtm
(controls=none: none) DIR/0.oldest, ...

A run that raises, kills its process, takes longer than time_limit=SECONDS or more memory than
memory_limit=MB (default null: no limit) is a row marked failed, with its reason; the others go on,
and the exit code is 1. With --fail-fast nothing new is started after the first failure.

Stopped by Ctrl-C, a crash or a reboot? rbtm-bench sweep --resume DIR does what is missing: runs
that are done stay as they are. It takes no settings but time_limit, memory_limit and Hydra's own,
such as hydra/launcher=joblib."""


def as_words(command: str, words: list[str]) -> list[str]:
    """The words for Hydra: a path in front as the settings that read it, text quoted."""
    from rbtm_bench.runs.words import as_typed, with_data

    first = words[0] if words else "-"
    is_path = os.path.exists(first)
    if command != "sweep" and (is_path or not ("=" in first or first.startswith(("-", "~")))):
        if not is_path:
            raise ConfigError(f"{first}: expected key=value, or a path to data (no such file)")
        words = with_data(words)
    return as_typed(words)


def parse(command: str, text: str, words: list[str]) -> tuple[argparse.Namespace, list[str]]:
    """Our own options and, as they are, the overrides."""
    parser = argparse.ArgumentParser(
        prog=f"rbtm-bench {command}",
        description=text,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        usage=f"rbtm-bench {command} [key=value ...] [options]",
        allow_abbrev=False,
    )
    parser.add_argument("--config-dir", "-cd", action="append", default=[], metavar="DIR")
    if command in ("compare", "sweep"):
        parser.add_argument(
            "--resume", metavar="DIR", help="do what is missing of what was asked for in DIR"
        )
        parser.add_argument(
            "--fail-fast", action="store_true", help="start nothing new after the first failure"
        )
        parser.add_argument(
            "--trust", action="store_true",
            help="with --resume: also what its sweep.json names outside rbtm_bench and its folder "
            "(plug-ins, another working folder)",
        )  # fmt: skip
    if command == "compare":
        parser.add_argument(
            "--jobs",
            "-j",
            type=int,
            default=None,
            help="runs side by side, each on a core of its own (default: all cores; "
            "1 for the cleanest times)",
        )
    options, rest = parser.parse_known_args(words)
    unknown = [word for word in rest if word.startswith("-")]
    if unknown:
        raise ConfigError(f"{unknown[0]}: no such option; see rbtm-bench {command} --help")
    strangers = [w for w in rest if w.find("=") < 1 and not w.startswith("~")]
    if strangers:
        raise ConfigError(f"{strangers[0]}: expected key=value")
    return options, rest


def run(words: list[str]) -> int:
    """``rbtm-bench run``."""
    options, overrides = parse("run", RUN_HELP, words)
    pin_unless_lifted(overrides)  # first of all: numpy sizes its thread pool when it is imported
    from rbtm_bench.datasets.summary import tell
    from rbtm_bench.engine import drive
    from rbtm_bench.report import screen
    from rbtm_bench.runs import experiment
    from rbtm_bench.runs.claim import default_folder
    from rbtm_bench.runs.plugins import foreign_modules
    from rbtm_bench.runs.settings import compose_settings

    settings = compose_settings(overrides, tuple(map(Path, options.config_dir)))
    if foreign_modules(settings.config):
        process.has_strangers()
    out = Path(settings.config["out"] or default_folder("runs", settings.choices))
    with bar("scans") as progress:
        if settings.config["time_limit"] is None and settings.config["memory_limit"] is None:
            experiment.run(settings, out, progress.update_to, opened=tell)
        else:
            drive.run_alone(settings, out, progress.update_to)
    print(screen.of_run(out))
    return 0


def pin_unless_lifted(overrides: list[str]) -> None:
    """Pin this process before a plug-in's module is looked up: it may import its library."""
    from rbtm_bench.runs.pinning import pin_to_free_core

    if not any(word.replace(" ", "").lower() == "pin=false" for word in overrides):
        pin_to_free_core()


def compare(words: list[str]) -> int:
    """``rbtm-bench compare``: a grid whose points the cores of this machine make."""
    options, overrides = parse("compare", COMPARE_HELP, words)
    from rbtm_bench.cli import session
    from rbtm_bench.engine import drive
    from rbtm_bench.engine.comparison import Comparison
    from rbtm_bench.runs.claim import default_folder

    jobs = options.jobs if options.jobs is not None else drive.default_jobs()
    if jobs < 1:
        raise ConfigError(f"--jobs {jobs}: expected at least 1")
    with session.asked("compare", words, options, overrides) as (asked, folder):
        grid = Comparison.of(asked.overrides, tuple(map(Path, asked.config_dirs)), jobs)
        out = folder or Path(grid.settings[0].config["out"] or default_folder("compare"))
        return session.carry_out(grid, asked, out, resumed=folder is not None)


def sweep(words: list[str]) -> int:
    """``rbtm-bench sweep``: Hydra's multirun over supervised runs."""
    options, overrides = parse("sweep", SWEEP_HELP, words)
    from rbtm_bench.cli import session
    from rbtm_bench.engine.hydra_sweep import SweepPlan
    from rbtm_bench.runs.claim import default_folder

    named = [] if options.resume else [word for word in overrides if word.startswith("out=")]
    kept = [word for word in overrides if word not in named]
    out = _one_folder(named[-1]) if named else None
    with session.asked("sweep", words, options, kept) as (asked, folder):
        grid = SweepPlan.of(asked.overrides, tuple(map(Path, asked.config_dirs)))
        out = folder or out or Path(default_folder("sweeps"))
        return session.carry_out(grid, asked, out, resumed=folder is not None)


def _one_folder(word: str) -> Path | None:
    """The folder that ``out=DIR`` names, None for ``out=null``."""
    from rbtm_bench.core.wording import shown
    from rbtm_bench.runs.settings import parsed

    (override,) = parsed([word])
    if override.is_sweep_override():
        raise ConfigError(f"{word}: a sweep has one folder")
    value = override.value()
    return None if value is None else Path(shown(value))


def hydra_itself(words: list[str]) -> int:
    """Hydra's own answers: ``--cfg``, ``--info``, ``--hydra-help``."""
    from rbtm_bench.runs.settings import hydra_main

    def task(cfg: Any) -> None:
        from rbtm_bench.engine import hydra_sweep

        hydra_sweep.run_job(cfg)

    hydra_main(words, task)
    return 0
