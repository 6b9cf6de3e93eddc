"""One run: settings in, a folder of files out.

A run folder holds ``config.yaml`` (resolved), ``run.json`` (status and provenance),
``steps.parquet`` (a row a scan), ``trajectory.tum``, ``metrics.json`` and ``map.npz``, and, where
they exist, ``ground_truth.tum``, ``similarity.npz``, ``relations.parquet`` (the error of every
relation) and ``metrics_common.json`` (``evaluation.COMMON``). Every file appears whole or not at
all.
"""

from __future__ import annotations

import contextlib
import os
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np

from rbtm_bench.backends.base import Backend
from rbtm_bench.backends.system import System
from rbtm_bench.core.errors import (
    ConfigError,
    DataError,
    RbtmBenchError,
    RunError,
    WriteError,
    one_line,
)
from rbtm_bench.core.files import make_folder, write_atomically, write_json, write_text
from rbtm_bench.core.kernels import make_ready
from rbtm_bench.core.process import settle
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array, Scan, StepTable, read_only
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.metrics.base import Metric
from rbtm_bench.metrics.cost import peak_memory_mb
from rbtm_bench.metrics.relation_errors import FILE as RELATIONS
from rbtm_bench.metrics.summary import REGISTERED, summarise_steps, why_unregistered
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.odometry.method import Method, Work
from rbtm_bench.odometry.system import system_odometry
from rbtm_bench.pairs.shared import SharedDataset
from rbtm_bench.pairs.watched import Watch, WatchedWork
from rbtm_bench.runs import evaluation, provenance, replicate
from rbtm_bench.runs.claim import claimed, refuse_existing
from rbtm_bench.runs.declared import PLUGIN_GROUPS
from rbtm_bench.runs.pinning import pin_to_free_core
from rbtm_bench.runs.plugins import foreign_modules, foreign_plugins, is_system, locate
from rbtm_bench.runs.settings import Settings
from rbtm_bench.runs.steps import write_steps
from rbtm_bench.similarity.base import Similarity

Progress = Callable[[int, int], None]
"""Called with scans done and scans in all."""

UNSHARED_BYTES = 150e6
"""Remembered of what foreign plug-ins were handed, where no workbench sets its own bound."""
TRACE = 20_000
"""Characters of a traceback that are kept: an error's own words may fill a disk."""
REGISTERING = ("backend", "search")
"""The groups that are one backend to the loop."""
SIMILARITY_PICTURE = 181
"""Scans at most in the similarity matrix that a run keeps: the paper's Fig. 1(c)."""


BLOCK = 256
"""Scans that a run reads ahead."""


@dataclass(frozen=True, eq=False)
class Parts:
    """A run's plug-ins, instantiated. A system is a method by itself. ``work`` is None where the
    plug-ins do all of it themselves."""

    dataset: SharedDataset
    method: Method | System
    metrics: tuple[Metric, ...]
    work: Work | None = None


class Bench(Protocol):
    """Gives a run its plug-ins; ``workbench.Workbench`` shares them between runs."""

    def parts(self, settings: Settings) -> Parts: ...


def run(
    settings: Settings,
    out: Path,
    progress: Progress | None = None,
    bench: Bench | None = None,
    opened: Callable[[Dataset], object] | None = None,
) -> dict[str, Any]:
    """Run one experiment into the folder ``out`` and return its ``run.json``.

    ``opened`` is called with the data set before it is read.
    With a ``bench`` the plug-ins answer from what earlier runs of the process have computed.
    Raises ``ConfigError``/``DataError`` before anything is written if the settings or the data
    are at fault. Once started, any failure is written to ``run.json`` with its reason and then
    raised.
    """
    overwrite = bool(settings.config["overwrite"])
    refuse_existing(out, overwrite)
    core = pin_to_free_core() if settings.config["pin"] else None
    parts = bench.parts(settings) if bench else instantiate(settings)
    record = provenance.of_run(settings, parts.dataset, core)
    if opened:
        opened(parts.dataset)
    with claimed(out, overwrite):
        clear(out)
        write_config(out, settings)
        write_json(out / "run.json", record)
        return _recorded(parts, settings, out, record, progress)


def _recorded(
    parts: Parts, settings: Settings, out: Path, record: dict[str, Any], progress: Progress | None
) -> dict[str, Any]:
    """The run, and how it ended in its ``run.json``."""
    try:
        record |= _execute(parts, settings, out, progress)
        _refuse_changes(parts, settings)
        _refuse_dead(parts, record)
        record["status"] = "done"
        record["dropped_points"] = parts.dataset.dropped()
    except BaseException as error:
        record["status"], record["reason"] = "failed", reason(error, settings)
        record["traceback"] = trace_of(error)
        with contextlib.suppress(WriteError):  # on a full disk the first file says it all
            _finish(out, record)
        raise
    _finish(out, record)
    return record


def _finish(out: Path, record: dict[str, Any]) -> None:
    record["finished"] = provenance.now()
    write_json(out / "run.json", record)


def fail(settings: Settings, out: Path, error: BaseException) -> None:
    """Leave a run that could not even start as a failed run with its reason."""
    make_folder(out)
    clear(out)
    write_config(out, settings)
    record = provenance.of_run(settings, None, None)
    record.update(status="failed", reason=reason(error, settings), finished=provenance.now())
    write_json(out / "run.json", record)


def instantiate(settings: Settings) -> Parts:
    """The plug-ins of checked settings; opens and validates the data set.

    Raises ``ConfigError`` where parts do not fit together, ``DataError`` for bad data.
    """
    plain = replicate.copy_of(build(settings.config["dataset"]), settings.config)
    check_fit(settings, plain)
    config = replicate.with_moved(settings.config, plain)
    watch = Watch(UNSHARED_BYTES) if foreign_modules(config) else None
    dataset = SharedDataset(plain, 0.0, watch)
    method, metrics = build_method(config), build_metrics(config)
    if watch is None or isinstance(method, System):
        return Parts(dataset, method, metrics)
    return Parts(dataset, method, metrics, WatchedWork(Work(method), watch))


def build_method(
    config: dict[str, Any], given: Mapping[str, Any] = MappingProxyType({})
) -> Method | System:
    """What is compared: the system of resolved settings, or all that goes with their backend;
    plug-ins that are ``given`` by group are taken as they are."""
    if "backend" not in given and is_system(config):
        system: System = build(config["backend"])
        return system
    groups = [group for group in PLUGIN_GROUPS if group != "dataset"]
    made = {g: given[g] if g in given else build(config[g]) for g in groups}
    return Method(
        backend=made.pop("search").before(made.pop("backend")),
        **made,
        guess_along_degenerate=config["guess_along_degenerate"],
        judge_points=config["judge_points"],
    )


def build_backend(config: dict[str, Any]) -> Backend:
    """The backend of resolved settings, behind their search."""
    backend: Backend = build(config["search"]).before(build(config["backend"]))
    return backend


def backend_node(config: dict[str, Any]) -> dict[str, Any]:
    """What tells the registrations of ``build_backend`` from others: with a search both nodes."""
    search = locate("search", config["search"]["_target_"])
    node: dict[str, Any] = config["backend"]
    return {g: config[g] for g in REGISTERING} if getattr(search, "searches", True) else node


def build_metrics(config: dict[str, Any]) -> tuple[Metric, ...]:
    """The metrics of resolved settings."""
    return tuple(build(node) for node in (config.get("metrics") or {}).values())


def check_fit(settings: Settings, dataset: Dataset) -> None:
    """Raise ``ConfigError`` if a chosen plug-in cannot work on the data set.

    Loads no backend library: only a backend's class is looked at.
    """
    config = settings.config
    check_dimensions(settings, dataset.planar)
    if is_system(config):
        return
    build(config["guess"]).check(dataset)
    _check_selector(settings, dataset)


def check_dimensions(settings: Settings, planar: bool, backend: Any = None) -> None:
    """Raise ``ConfigError`` if what registers is not for ``planar`` scans, or for others; a
    ``backend`` that is an object stands for the one of the settings."""
    config = settings.config
    needed = "2d" if planar else "3d"
    for group in REGISTERING[:1] if is_system(config) else REGISTERING:
        given = backend if group == "backend" else None
        plugin = given or locate(group, config[group]["_target_"])
        name = f"={settings.choices.get(group)}" if given is None else ""
        dimensions = getattr(plugin, "dimensions", ("2d", "3d"))  # a factory function has none
        if needed not in dimensions:
            raise ConfigError(
                f"{group}{name} is for {', '.join(dimensions)} only; this data set is {needed}"
            )


def _check_selector(settings: Settings, dataset: Dataset) -> None:
    """Raise ``ConfigError`` if the selector lacks scores, truth or a check that it needs."""
    config, choices = settings.config, settings.choices
    name = f"selector={choices.get('selector')}"
    selector = locate("selector", config["selector"]["_target_"])
    if getattr(selector, "needs_scores", False):
        build(config["similarity"]).check(dataset)
    if getattr(selector, "needs_truth", False) and not dataset.has_ground_truth:
        path = config["dataset"].get("path")
        where = f"dataset={choices.get('dataset')}" + (f" ({path})" if path else "")
        raise ConfigError(
            f"{name} chooses by ground truth, and {where} has none: "
            "expected a data set with the true pose of every scan"
        )
    check = locate("check", config["check"]["_target_"])
    if getattr(selector, "needs_check", False) and getattr(check, "accepts_all", False):
        raise ConfigError(
            f"{name} needs a check, and check={choices.get('check')} accepts everything: "
            "expected one that can reject, such as check=gated"
        )


def build(node: dict[str, Any]) -> Any:
    """Instantiate one plug-in by Hydra, ready to be timed; our own errors come out as they are."""
    import hydra.utils
    from hydra.errors import InstantiationException

    try:
        made = hydra.utils.instantiate(node, _convert_="all")
        make_ready()
        return made
    except InstantiationException as error:
        cause: BaseException | None = error
        while cause is not None:
            if isinstance(cause, RbtmBenchError):
                raise cause from None
            if isinstance(cause, ImportError):
                raise ConfigError(
                    f"{node['_target_']} needs a package that is not there: {cause}; "
                    "see rbtm-bench doctor"
                ) from error
            cause = cause.__cause__ or cause.__context__
        lines = [line for line in str(error).splitlines() if not line.startswith("full_key")]
        raise ConfigError(" ".join(lines)) from error


def reason(error: BaseException, settings: Settings | None = None) -> str:
    """One line that says why a run with these settings failed, and in which of its plug-ins, as far
    as they are not ours: unless settings or data are at fault."""
    text = one_line(error)
    if not isinstance(error, RbtmBenchError):
        text = f"{type(error).__name__}: {text}" if text else type(error).__name__
    known = settings is None or isinstance(error, ConfigError | DataError)
    names = "" if settings is None or known else foreign_plugins(settings.config, settings.choices)
    return f"{names}: {text}" if names and names not in text else text or type(error).__name__


def trace_of(error: BaseException) -> str:
    """The traceback of an error, its last lines if it is very long."""
    text = "".join(traceback.format_exception(error))
    return text[-TRACE:]


def _refuse_changes(parts: Parts, settings: Settings) -> None:
    """Raise ``RunError`` if a plug-in has written into what it was handed to read."""
    changed = parts.dataset.watch.changed() if parts.dataset.watch else []
    if changed:
        names = foreign_plugins(settings.config, settings.choices)
        others = f" (and {len(changed) - 1} more)" if changed[1:] else ""
        raise RunError(f"{names} changed {changed[0]}{others}")


def _refuse_dead(parts: Parts, record: dict[str, Any]) -> None:
    """Raise ``RunError`` if a method that is no baseline has registered no scan at all."""
    method = parts.method if isinstance(parts.method, System) else parts.method.backend
    asked = len(parts.dataset) - 1
    if asked < 1 or record["registered"] or getattr(method, "is_baseline", False):
        return
    why = one_line(record["why_unregistered"], 200)
    raise RunError(f"none of {asked} scans was registered" + (f": {why}" if why else ""))


def _execute(
    parts: Parts, settings: Settings, out: Path, progress: Progress | None
) -> dict[str, Any]:
    """The loop and its files; returns the loop's wall time in s, how many scans were registered
    (and why others were not), and the trajectory's checksum."""
    settle()
    started = time.perf_counter()
    dataset = parts.dataset
    steps, poses = StepTable(), []
    truth: list[Array] = []
    own = os.getpid()

    def stream() -> Iterator[Scan]:
        for scan in dataset:
            known = scan.ground_truth is not None
            truth.append(scan.ground_truth if known else np.full((4, 4), np.nan))  # type: ignore[arg-type]
            yield scan

    if isinstance(parts.method, System):
        stepping = system_odometry(stream(), parts.method)
    else:  # a stranger's plug-ins are looked after scan by scan
        block = BLOCK if dataset.watch is None else 1
        stepping = odometry(stream(), parts.method, parts.work, block)
    for step in stepping:
        if os.getpid() != own:
            os._exit(1)  # a twin that a plug-in has forked and not ended: there is one run
        steps.add(step.record)
        poses.append(step.T_world_scan)
        if dataset.watch is not None:  # before the next scan's plug-ins see it
            dataset.watch.hand(f"scan {step.record.scan}'s pose", step.T_world_scan)
        if progress:
            progress(len(steps), len(dataset))
    seconds, memory = time.perf_counter() - started, peak_memory_mb()
    stamps = np.array(steps["stamp"])
    estimate = Trajectory(stamps, read_only(np.stack(poses)))
    reference = Trajectory(stamps, read_only(np.stack(truth))) if dataset.has_ground_truth else None
    write_steps(out / "steps.parquet", steps)
    estimate.write_tum(out / "trajectory.tum")
    if reference is not None and reference.known.all():
        reference.write_tum(out / "ground_truth.tum")
    judged = (parts.metrics, estimate, reference, dataset)
    evaluation.write_metrics(out, summarise_steps(steps, memory), *judged)
    evaluation.write_common(out, settings.config, *judged)
    if settings.config["pictures"]:
        _write_pictures(parts, estimate, float(settings.config["map_resolution"]), out)
    return {
        "seconds": seconds,
        "registered": sum(status in REGISTERED for status in steps["status"]),
        "why_unregistered": why_unregistered(steps),
        "trajectory_sha256": evaluation.checksum(estimate, dataset.scored_from),
    }


def _write_pictures(parts: Parts, estimate: Trajectory, resolution: float, out: Path) -> None:
    """What pictures need beyond the steps: the map, as points and as an occupancy grid of what
    planar scans saw, and a similarity matrix."""
    from rbtm_bench.runs.mapping import build_map

    points = build_map(parts.dataset, estimate.T_world_scan, resolution)
    grid: dict[str, Any] = {}
    if parts.dataset.planar:  # in space a beam seen from above crosses walls that it passes over
        from rbtm_bench.runs.occupancy import build_grid

        poses = estimate.T_world_scan
        grid = build_grid(parts.dataset, poses, points, resolution).arrays()
    write_npz(out / "map.npz", points=points, **grid)
    if isinstance(parts.method, System) or not parts.method.selector.needs_scores:
        return
    scans, scores = similarity_matrix(parts.dataset, parts.method.similarity)
    write_npz(out / "similarity.npz", scans=scans, scores=scores)


def similarity_matrix(dataset: Dataset, similarity: Similarity) -> tuple[Any, Array]:
    """Scan numbers (K,) and scores (K, K) of at most 181 scans spread over the data set."""
    count = min(len(dataset), SIMILARITY_PICTURE)
    scans = np.unique(np.linspace(0, len(dataset) - 1, count).round().astype(np.int64))
    descriptors = np.stack([similarity.describe(dataset[int(i)].without_truth()) for i in scans])
    return scans, similarity.matrix(descriptors)


def write_npz(path: Path, **arrays: Any) -> None:
    """A compressed numpy archive."""

    def write(partial: Path) -> None:
        with open(partial, "wb") as file:
            np.savez_compressed(file, **arrays)

    write_atomically(path, write)


def write_config(out: Path, settings: Settings) -> None:
    """``config.yaml``: the resolved settings, enough to run the same again."""
    from omegaconf import OmegaConf

    write_text(out / "config.yaml", OmegaConf.to_yaml(OmegaConf.create(settings.config)))


FILES = (
    "config.yaml",
    "run.json",
    "steps.parquet",
    "trajectory.tum",
    "ground_truth.tum",
    "metrics.json",
    evaluation.COMMON,
    "map.npz",
    "similarity.npz",
    RELATIONS,
)


def clear(out: Path) -> None:
    """Remove an earlier run's files, and only those."""
    for name in FILES:
        (out / name).unlink(missing_ok=True)
