"""The subcommands that run things: run, compare, sweep."""

from __future__ import annotations

import argparse
import datetime
import os
import sys
from pathlib import Path
from typing import Any

from rbtm_bench.errors import ConfigError, RunError
from rbtm_bench.progress import bar

RUN_HELP = """\
One experiment: a data set, a backend, a selector; a folder of results and a summary.

examples
  rbtm-bench run                                                   the embedded corridor
  rbtm-bench run backend=open3d_gicp selector=previous seed=3
  rbtm-bench run dataset=carmen dataset.path=aces.clf.gz dataset.relations=aces.relations
  rbtm-bench run dataset=cloud_folder dataset.path=clouds similarity=virtual_scan

The folder (out=DIR) holds config.yaml, run.json, steps.parquet (a row a scan), trajectory.tum,
metrics.json and map.npz. An existing one is refused unless overwrite=true.
rbtm-bench list shows what there is to choose; --cfg job prints the composed settings."""

COMPARE_HELP = """\
A grid of experiments, one table. Comma lists multiply; a key such as selector.window applies to
every chosen member that has it, and points that coincide are merged.

examples
  rbtm-bench compare backend=none,open3d_p2p selector=previous,keyframe,rbtm selector.window=10
  rbtm-bench compare selector=rbtm,random_gap selector.threshold=0.6,0.8 seed=0,1,2,3,4

selector=random_gap draws its gaps from the comparison's own rbtm run.
The folder (out=DIR) holds a run folder for every point, table.csv (a row a run) and summary.csv
(a row a method, medians over seeds)."""

SWEEP_HELP = """\
Hydra's multirun: every combination of the comma lists, with Hydra's own launchers.

example
  rbtm-bench sweep backend=open3d_p2p,kiss_icp selector.threshold=0.6,0.7 hydra/launcher=joblib

out=DIR is the folder of the sweep; its runs are DIR/0, DIR/1, ..."""


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
    from rbtm_bench import experiment, summary
    from rbtm_bench.settings import compose_settings

    pin_unless_lifted(overrides)
    settings = compose_settings(overrides, tuple(map(Path, options.config_dir)))
    out = Path(settings.config["out"] or default_folder("runs", settings.choices))
    with bar("scans") as progress:
        experiment.run(settings, out, progress.update_to)
    print(summary.of_run(out))
    return 0


def pin_unless_lifted(overrides: list[str]) -> None:
    """Pin this process before a plug-in's module is looked up: it may import its library."""
    from rbtm_bench.pinning import pin_to_free_core

    if not any(word.replace(" ", "").lower() == "pin=false" for word in overrides):
        pin_to_free_core()


def compare(words: list[str]) -> int:
    """``rbtm-bench compare``."""
    options, overrides = parse("compare", COMPARE_HELP, words)
    from rbtm_bench import comparison, summary
    from rbtm_bench.experiment import refuse_existing
    from rbtm_bench.files import make_folder
    from rbtm_bench.grid import make_points

    jobs = options.jobs if options.jobs is not None else comparison.default_jobs()
    if jobs < 1:
        raise ConfigError(f"--jobs {jobs}: expected at least 1")
    if jobs == 1:
        pin_unless_lifted(overrides)
    points, notes = make_points(overrides, tuple(map(Path, options.config_dir)))
    out = Path(points[0].settings.config["out"] or default_folder("compare"))
    refuse_existing(out, bool(points[0].settings.config["overwrite"]))
    for note in notes:
        print(note, file=sys.stderr)
    comparison.check_data(points)
    make_folder(out)
    failed: list[str] = []
    with bar("runs", len(points)) as progress:

        def done(name: str, record: dict[str, Any]) -> None:
            if record["status"] != "done":
                failed.append(f"{name}: {record['reason']}")
            progress.step(f"{len(failed)} failed" if failed else "")

        comparison.run_points(points, out, jobs, done)
    print(summary.of_runs(out, [out / point.name for point in points]))
    return _report_failures(failed, len(points))


def sweep(words: list[str]) -> int:
    """``rbtm-bench sweep``: Hydra's multirun over ``experiment.run``."""
    options, overrides = parse("sweep", SWEEP_HELP, words)
    from rbtm_bench import comparison, summary
    from rbtm_bench.experiment import refuse_existing
    from rbtm_bench.grid import Point, check_values

    out = Path(default_folder("sweeps"))
    kept = []
    for word in overrides:
        if word.partition("=")[0] == "out":
            out = _one_folder(word) or out
        else:
            kept.append(word)
    launchers = [word for word in kept if word.startswith("hydra/launcher=")]
    if launchers in ([], ["hydra/launcher=basic"]):
        pin_unless_lifted(kept)  # the jobs run in this very process
    first = check_values(kept, tuple(map(Path, options.config_dir)))
    refuse_existing(out, bool(first.config["overwrite"]))
    comparison.check_data([Point("first", first)])
    flags = [part for folder in options.config_dir for part in ("--config-dir", folder)]
    folder = str(out).replace("'", "\\'")
    hydra_main([*flags, "--multirun", f"hydra.sweep.dir='{folder}'", *kept], sweep_job)
    runs = sorted((p.parent for p in out.glob("*/run.json")), key=_by_number)
    if not runs:
        raise RunError(f"{out}: the sweep left no run")
    print(summary.of_runs(out, runs))
    return _report_failures(summary.failures(runs), len(runs))


def _one_folder(word: str) -> Path | None:
    """The folder that ``out=DIR`` names, None for ``out=null``."""
    from rbtm_bench.settings import parsed, shown

    (override,) = parsed([word])
    if override.is_sweep_override():
        raise ConfigError(f"{word}: a sweep has one folder")
    value = override.value()
    return None if value is None else Path(shown(value))


def hydra_itself(words: list[str]) -> int:
    """Hydra's own answers: ``--cfg``, ``--info``, ``--hydra-help``."""
    hydra_main(words, sweep_job)
    return 0


def hydra_main(words: list[str], task: Any) -> None:
    """Call Hydra with our configs; its errors become ours."""
    import hydra
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    from rbtm_bench.settings import config_dir, explain

    argv, before = sys.argv, os.environ.get("HYDRA_FULL_ERROR")
    sys.argv = ["rbtm-bench", *words]
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra raises instead of printing and exiting with 1
    try:
        hydra.main(config_path=str(config_dir()), config_name="config", version_base="1.3")(task)()
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(explain(error)) from error
    finally:
        sys.argv = argv
        if before is None:
            del os.environ["HYDRA_FULL_ERROR"]


def sweep_job(cfg: Any) -> None:
    """One job of a sweep, in whatever process the launcher runs it; never raises."""
    from hydra.core.hydra_config import HydraConfig
    from omegaconf import OmegaConf, open_dict

    from rbtm_bench import comparison, experiment
    from rbtm_bench.settings import Settings, from_hydra

    hydra_cfg = HydraConfig.get()
    out = Path(hydra_cfg.runtime.output_dir)
    full = cfg.copy()
    with open_dict(full):
        full.hydra = hydra_cfg
    words = tuple(hydra_cfg.overrides.task)
    try:
        settings = from_hydra(full, words)
    except ConfigError as error:
        plain = OmegaConf.to_container(cfg, resolve=False)
        choices = {str(k): str(v) for k, v in hydra_cfg.runtime.choices.items()}
        assert isinstance(plain, dict)
        experiment.fail(Settings({str(k): v for k, v in plain.items()}, choices, words), out, error)
        return
    comparison.run_one(out.name, settings, out)


def default_folder(kind: str, choices: dict[str, str] | None = None) -> str:
    """results/<kind>/<time>[-<data set>-<backend>-<selector>], a new one every time."""
    stamp = datetime.datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    names = [choices[group] for group in ("dataset", "backend", "selector")] if choices else []
    stem = "-".join([f"results/{kind}/{stamp}", *names])
    folder, count = stem, 2
    while Path(folder).exists():
        folder, count = f"{stem}-{count}", count + 1
    return folder


def _by_number(path: Path) -> tuple[int, str]:
    return (int(path.name) if path.name.isdigit() else 0, path.name)


def _report_failures(failed: list[str], total: int) -> int:
    if not failed:
        return 0
    print(f"{len(failed)} of {total} runs failed:", file=sys.stderr)
    for line in failed[:10]:
        print(f"  {line}", file=sys.stderr)
    if len(failed) > 10:
        print(f"  ... and {len(failed) - 10} more", file=sys.stderr)
    return 1
