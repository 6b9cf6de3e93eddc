"""One run: settings in, a folder of files out.

A run folder holds ``config.yaml`` (resolved), ``run.json`` (status and provenance),
``steps.parquet`` (a row a scan), ``trajectory.tum``, ``metrics.json`` and ``map.npz``, and, where
they exist, ``ground_truth.tum``, ``looped.tum`` and ``graph.g2o`` (the trajectory with its loops
closed, and the pose graph behind it), ``similarity.npz``, ``relations.parquet`` (the error of every
relation) and ``metrics_common.json`` (``evaluation.COMMON``). Every file appears whole or not at
all.
"""

from __future__ import annotations

import contextlib
import os
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from rbtm_bench.backends.system import System
from rbtm_bench.core.errors import (
    ConfigError,
    DataError,
    RbtmBenchError,
    RunError,
    WriteError,
    one_line,
)
from rbtm_bench.core.files import make_folder, write_json, write_text
from rbtm_bench.core.process import settle
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array, Scan, StepTable, read_only
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.loops.base import Route
from rbtm_bench.metrics.cost import peak_memory_mb
from rbtm_bench.metrics.relation_errors import FILE as RELATIONS
from rbtm_bench.metrics.summary import REGISTERED, summarise_steps, why_unregistered
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.odometry.method import Work
from rbtm_bench.odometry.system import system_odometry
from rbtm_bench.runs import evaluation, provenance
from rbtm_bench.runs.assembly import Parts, instantiate
from rbtm_bench.runs.claim import claimed, refuse_existing
from rbtm_bench.runs.looped import FILES as LOOP_FILES
from rbtm_bench.runs.looped import close_loops
from rbtm_bench.runs.pictures import write_pictures
from rbtm_bench.runs.pinning import pin_to_free_core
from rbtm_bench.runs.plugins import (
    foreign_plugins,
)
from rbtm_bench.runs.settings import Settings
from rbtm_bench.runs.steps import write_steps

Progress = Callable[[int, int], None]
"""Called with scans done and scans in all."""

TRACE = 20_000
"""Characters of a traceback that are kept: an error's own words may fill a disk."""
BLOCK = 256
"""Scans that a run reads ahead."""


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
    record = provenance.of_run(settings, parts.dataset, core, parts.determined)
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
    asked = len(parts.dataset) - 1 - record["still"]  # a robot that stands asks for nothing
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
    work, route = parts.work, Route()

    def stream() -> Iterator[Scan]:
        for scan in dataset:
            known = scan.ground_truth is not None
            truth.append(scan.ground_truth if known else np.full((4, 4), np.nan))  # type: ignore[arg-type]
            yield scan

    if isinstance(parts.method, System):
        stepping = system_odometry(stream(), parts.method)
    else:  # a stranger's plug-ins are looked after scan by scan
        block = BLOCK if dataset.watch is None else 1
        work = work or Work(parts.method)
        stepping = odometry(stream(), parts.method, work, block)
    for step in stepping:
        if os.getpid() != own:
            os._exit(1)  # a twin that a plug-in has forked and not ended: there is one run
        steps.add(step.record)
        poses.append(step.T_world_scan)
        if parts.loops and not parts.loops.is_off:
            route.add(step)
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
    looped, counts = close_loops(parts.loops, route, stamps, dataset, work, out)
    judged = (parts.metrics, estimate, reference, dataset, looped)
    evaluation.write_metrics(out, {**summarise_steps(steps, memory), **counts}, *judged)
    evaluation.write_common(out, settings.config, *judged)
    if settings.config["pictures"]:
        write_pictures(dataset, parts.method, estimate, settings.config["map_resolution"], out)
    return {
        "seconds": seconds,
        "still": steps["status"].count("still"),
        "registered": sum(status in REGISTERED for status in steps["status"]),
        "why_unregistered": why_unregistered(steps),
        "trajectory_sha256": evaluation.checksum(estimate, dataset.scored_from),
    }


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
    *LOOP_FILES,
)


def clear(out: Path) -> None:
    """Remove an earlier run's files, and only those."""
    for name in FILES:
        (out / name).unlink(missing_ok=True)
