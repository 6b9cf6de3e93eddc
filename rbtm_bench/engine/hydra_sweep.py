"""The jobs of a sweep: Hydra's multirun over supervised runs, with whatever launcher."""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import os
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf, open_dict

from rbtm_bench.core.errors import ConfigError, RbtmBenchError
from rbtm_bench.engine import beside, drive, one_run, sweep_folder
from rbtm_bench.engine.crew import Supervisor, own_supervisor
from rbtm_bench.engine.driver import Grid, Told
from rbtm_bench.engine.progress import RunBar
from rbtm_bench.engine.sweep_folder import Asked
from rbtm_bench.runs import controls
from rbtm_bench.runs.experiment import reason
from rbtm_bench.runs.grid import Point, one_way_to_run, values_beside_first
from rbtm_bench.runs.plugins import make_importable
from rbtm_bench.runs.settings import (
    Settings,
    compose_settings,
    composed,
    composing,
    from_hydra,
    hydra_main,
    parsed,
)

LAUNCHERS = {
    "ray": ("hydra_plugins.hydra_ray_launcher", "ray"),
    "slurm": ("hydra_plugins.hydra_submitit_launcher", "slurm"),
    "submitit": ("hydra_plugins.hydra_submitit_launcher", "slurm"),
}
"""How launchers that may be missing are called: their module, and the extra to install."""

POLL_S = 0.5
"""How often the bar looks for runs that have ended."""

MOST_COMPOSED = 64
"""Jobs, at most, that are composed to say what they will ask for: each takes Hydra 0.06 s."""

MOST_ALIKE = 256
"""Kinds of jobs, at most, that are composed to find their controls."""
ONE_VALUE = ("selector.threshold=", "replicate=")
"""Settings that no other follows from: jobs that differ in them alone are composed once."""

_here: tuple[Supervisor, RunBar] | None = None
"""What runs of this very process use, where the sweep runs in it."""


@dataclass(frozen=True)
class SweepPlan(Grid):
    """The jobs of a sweep, made by one of Hydra's launchers: the words of every job, None where a
    sweeper makes them up as it goes; those that controls are for; Hydra's words; is it one
    process?"""

    jobs: list[list[str]] | None
    points: list[Point]
    words: list[str]
    one_process: bool
    extra_dirs: tuple[Path, ...]

    @classmethod
    def of(cls, overrides: list[str], extra_dirs: tuple[Path, ...]) -> SweepPlan:
        """Check every value and find out the jobs. Raises ``ConfigError``."""
        for word in overrides:
            if word.partition("=")[0] in ("hydra.sweep.dir", "hydra.sweep.subdir"):
                raise ConfigError(f"{word}: out=DIR names a sweep's folder; its runs are numbered")
        hydra_words = [word for word in overrides if word.startswith("hydra")]
        task, notes = one_way_to_run(
            [word for word in overrides if word not in hydra_words], extra_dirs
        )
        _require_launcher(hydra_words)
        with composing(extra_dirs) as extra:
            experiment = [word for word in task if word.startswith("+experiment=")]
            node = composed([*hydra_words, *experiment, *extra]).hydra
            fixed = _fixed(node.sweeper)
            jobs = None if fixed is None else _product([*fixed, *task])
        settings = values_beside_first([*(fixed or []), *task], extra_dirs)
        beyond = _is_beyond(node.launcher)
        _require_own_stores(beyond, settings)
        kind, at_once = str(node.launcher.get("_target_")), None
        alone = kind.endswith(".BasicLauncher")
        if kind.endswith(".JoblibLauncher"):
            at_once = int(node.launcher.get("n_jobs") or -1)
            at_once = at_once if at_once > 0 else max(1, drive.default_jobs() + 1 + at_once)
        words = [*extra, *hydra_words, *task]
        points, why = _points_with_controls(jobs, settings, beyond, extra_dirs)
        added = controls.plan(points)
        notes += [*([f"no controls: {why}"] if why else []), *added.notes]
        workers = 1 if alone else at_once
        return cls(settings, notes, workers, added, jobs, points, words, alone, extra_dirs)

    @property
    def labels(self) -> dict[str, str] | None:
        if self.jobs is None:
            return None
        jobs = {str(number): f"{number} ({' '.join(job)})" for number, job in enumerate(self.jobs)}
        return jobs | {name: name for name in self.controls.names}

    def finished(self, out: Path) -> set[str]:
        whole = {p.name for p in sweep_folder.run_folders(out) if sweep_folder.is_whole(p)}
        return whole | beside.finished(self.controls, self.points, out)

    def to_check(self, kept: set[str]) -> tuple[list[Point], list[Point] | str]:
        points = [Point(str(number), settings) for number, settings in enumerate(self.settings)]
        if self.jobs is None:
            return points, "the sweeper makes up its jobs as it goes"
        added = [point for point in self.controls.planned if point.name not in kept]
        points += added
        if len(self.jobs) == len(self.settings) and not kept:
            return points, points
        rest = [(str(n), job) for n, job in enumerate(self.jobs) if str(n) not in kept]
        if len(rest) > MOST_COMPOSED:
            return points, f"more than {MOST_COMPOSED} jobs are not looked into"
        made = []
        for name, job in rest:
            with contextlib.suppress(ConfigError):  # such a job fails, and asks for nothing
                made.append(Point(name, compose_settings(job, self.extra_dirs)))
        return points, [*made, *added]

    def launch(
        self, kept: set[str], asked: Asked, crew: Sequence[Supervisor], told: Told
    ) -> str | None:
        global _here
        crew[0].cwd = _place(asked)
        if not self.one_process:
            crew[0].close()
        folder = str(told.out.resolve()).replace("'", "\\'")  # workers may be at home elsewhere
        words = ["--multirun", f"hydra.sweep.dir='{folder}'", *self.words]
        _here = (crew[0], told.bar) if self.one_process else None
        try:
            with _watched(kept, told):
                hydra_main(words, run_job)
        except RbtmBenchError:
            raise
        except Exception as error:  # a worker that was killed, a disk that is full
            sweep_folder.check_ctrl_c()
            return reason(error)
        finally:
            _here = None
        sweep_folder.check_ctrl_c()
        self._make_controls(kept, asked, crew, told)
        return None

    def _make_controls(
        self, kept: set[str], asked: Asked, crew: Sequence[Supervisor], told: Told
    ) -> None:
        """The controls, by processes of this one, as many as the launcher had at a time."""
        with contextlib.ExitStack() as stack:
            if not self.one_process and self.controls.names:
                crew = stack.enter_context(drive.make_crew(self.workers or 1, asked.command))
            beside.make(self.controls, self.points, kept, crew, told, asked.fail_fast)


def _fixed(sweeper: DictConfig) -> list[str] | None:
    """The words that Hydra's own sweeper adds from its config; None for another sweeper."""
    if not str(sweeper.get("_target_")).endswith(".BasicSweeper"):
        return None
    return [f"{key}={value}" for key, value in (sweeper.get("params") or {}).items()]


def _require_launcher(words: list[str]) -> None:
    """Raise ``ConfigError`` naming the extra to install if the launcher's package is missing."""
    for word in words:
        key, _, name = word.partition("=")
        for start, (module, extra) in LAUNCHERS.items():
            if key != "hydra/launcher" or not name.startswith(start):
                continue
            if importlib.util.find_spec(module) is None:
                raise ConfigError(f"{word}: not installed: pip install 'rbtm-bench[{extra}]'")


def _is_beyond(launcher: DictConfig) -> bool:
    """Whether runs go to other machines than this one."""
    kind = str(launcher.get("_target_")).rpartition(".")[2]
    return kind == "SlurmLauncher" or (
        kind == "RayLauncher" and launcher.ray.init.get("address") not in (None, "local")
    )


def _require_own_stores(beyond: bool, settings: list[Settings]) -> None:
    """Raise ``ConfigError`` if several machines would write one pair store: they cannot."""
    if beyond and any(one.config["pairs"]["store"] == "shared" for one in settings):
        raise ConfigError(
            "pairs.store=shared: the machines of a cluster cannot share one file safely; "
            "add pairs.store=per_worker (merged at the end; docs/pairstore.md)"
        )


def _points_with_controls(
    jobs: list[list[str]] | None,
    settings: list[Settings],
    beyond: bool,
    extra_dirs: tuple[Path, ...],
) -> tuple[list[Point], str]:
    """The jobs as points beside which controls belong, or why there are to be none."""
    if settings[0].config["controls"] == "none":
        return [], ""
    if jobs is None:
        return [], "the sweeper makes up its jobs as it goes"
    if beyond:
        return [], "other machines make the runs; compare, or a sweep of them, makes controls"
    alike: dict[tuple[str, ...], Settings] = {}
    points = []
    for number, job in enumerate(jobs):
        fixed = tuple(word for word in job if not _is_one_value(word))
        if fixed not in alike:
            if len(alike) == MOST_ALIKE:
                return [], f"more than {MOST_ALIKE} different jobs are not looked into"
            with contextlib.suppress(ConfigError):  # such a job fails by itself
                alike[fixed] = compose_settings(job, extra_dirs)
        if fixed in alike:
            points.append(Point(str(number), _with_values(alike[fixed], job)))
    return points, ""


def _is_one_value(word: str) -> bool:
    """Whether a word is one of ``ONE_VALUE`` with a number."""
    try:
        return word.startswith(ONE_VALUE) and float(word.partition("=")[2]) is not None
    except ValueError:  # ${point.threshold}
        return False


def _with_values(settings: Settings, job: list[str]) -> Settings:
    """Settings with the job's own values of ``ONE_VALUE``."""
    config = dict(settings.config)
    for override in parsed([word for word in job if _is_one_value(word)]):
        group, _, name = override.key_or_group.partition(".")
        config[group] = {**config[group], name: override.value()} if name else override.value()
    return replace(settings, config=config, overrides=tuple(job))


def _product(words: list[str]) -> list[list[str]]:
    """The words of every job of Hydra's own sweeper, in its order."""
    from hydra._internal.core_plugins.basic_sweeper import BasicSweeper

    (batch,) = BasicSweeper.split_arguments(parsed(words), None)
    return [list(job) for job in batch]


def run_job(cfg: DictConfig) -> None:
    """One job in whatever process the launcher runs it: a finished run is left as it is, any
    other is done in a child of this process. Never raises but for Ctrl-C."""
    from hydra.core.hydra_config import HydraConfig

    sweep_folder.check_ctrl_c()
    hydra_cfg = HydraConfig.get()
    folder, out = Path(hydra_cfg.sweep.dir), Path(hydra_cfg.runtime.output_dir)
    asked = Asked.read(folder)
    make_importable(map(Path, asked.config_dirs))  # a launcher's process may be a new one
    if "joblib" in str(hydra_cfg.launcher.get("_target_")).lower():
        _end_with(asked.pid)
    with sweep_folder.at_work(folder, alone=False):
        if (folder / sweep_folder.STOP).exists():
            return
        record = _run(cfg, hydra_cfg, out, asked)
    if record["status"] != "done":
        if asked.fail_fast:
            with contextlib.suppress(OSError):
                (folder / sweep_folder.STOP).touch()
        sweep_folder.tell_unwritten(out, record)


def _run(cfg: DictConfig, hydra_cfg: Any, out: Path, asked: Asked) -> dict[str, Any]:
    """The job's run.json, from the folder or from a run."""
    full = cfg.copy()
    with open_dict(full):
        full.hydra = hydra_cfg
    words = tuple(hydra_cfg.overrides.task)
    try:
        settings = from_hydra(full, words)
    except ConfigError as error:
        sweep_folder.check_ctrl_c()
        plain = OmegaConf.to_container(cfg, resolve=False)
        assert isinstance(plain, dict)
        choices = {str(k): str(v) for k, v in hydra_cfg.runtime.choices.items()}
        settings = Settings({str(k): v for k, v in plain.items()}, choices, words)
        sweep_folder.clear([out])
        return one_run.ended_by(error, settings, out)
    if sweep_folder.is_finished(out, settings):
        return sweep_folder.record_of(out)
    sweep_folder.clear([out])
    settings = drive.sharing(settings, Path(hydra_cfg.sweep.dir))
    settings = replace(settings, config={**settings.config, "overwrite": True})
    supervisor = _here[0] if _here else own_supervisor(_place(asked), asked.command)
    part = functools.partial(_here[1].part, out.name) if _here else None
    return supervisor.run(out.name, settings, out, part)


def _place(asked: Asked) -> Path | None:
    """Where the sweep's relative paths begin, unless this machine has no such folder."""
    return Path(asked.cwd) if Path(asked.cwd).is_dir() else None


@functools.cache
def _end_with(driver: int) -> None:
    """Let this process, a worker of the driver's own, end soon after the driver has died.

    It would go on with the jobs that it has been sent, or wait for more and keep its core.
    """

    def watch() -> None:
        while os.getppid() == driver:
            time.sleep(POLL_S)
        os._exit(1)

    if os.getpid() != driver:
        threading.Thread(target=watch, daemon=True).start()


@contextlib.contextmanager
def _watched(reused: set[str], told: Told) -> Iterator[None]:
    """Tell of the runs that begin and end, whichever process they run in."""
    ended = set(reused)
    over = threading.Event()

    def look() -> None:
        with contextlib.suppress(OSError):
            for folder in sweep_folder.run_folders(told.out):
                if folder.name in ended:
                    continue
                record = sweep_folder.record_of(folder)
                if record.get("status") == "started":
                    told.bar.began(folder.name)
                elif record.get("status") in ("done", "failed"):
                    ended.add(folder.name)
                    told(folder.name, record)

    def watch() -> None:
        while not over.wait(POLL_S):
            look()

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        look()
