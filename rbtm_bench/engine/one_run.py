"""One run of many, in a worker: it never raises, and leaves a folder that says how it ended."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rbtm_bench.core.errors import RbtmBenchError, RunError
from rbtm_bench.core.files import write_json
from rbtm_bench.datasets import summary
from rbtm_bench.engine import sweep_folder
from rbtm_bench.engine.child import end_left_processes
from rbtm_bench.runs import assembly, experiment, provenance
from rbtm_bench.runs.claim import refuse_existing
from rbtm_bench.runs.grid import Point
from rbtm_bench.runs.identity import node_key
from rbtm_bench.runs.plugins import foreign_modules, foreign_plugins
from rbtm_bench.runs.settings import Settings
from rbtm_bench.runs.workbench import own_workbench


def foreign_to(points: Sequence[Point]) -> frozenset[str]:
    """The packages, other than ours, that the points' plug-ins come from."""
    return frozenset().union(*(foreign_modules(point.settings.config) for point in points))


def check_data(points: Sequence[Point]) -> dict[str, int]:
    """Open every data set once, before the first run, and see that the parts fit it; how many
    scans each has, by ``node_key``.

    Raises ``DataError`` or ``ConfigError``: bad data common to all points stop a grid.
    """
    opened: dict[str, Any] = {}
    scans: dict[str, int] = {}
    checked = set()
    for point in points:
        config = point.settings.config
        key = node_key(config["dataset"])
        if key not in opened:
            opened.clear()  # one data set in memory at a time
            opened[key] = assembly.build(config["dataset"])
            scans[key] = len(opened[key])
            summary.tell(opened[key])
        groups = ("backend", "search", "guess", "similarity", "selector", "check", "target")
        fit = repr((key, [config.get(group) for group in groups]))
        if fit not in checked:
            checked.add(fit)
            assembly.check_fit(point.settings, opened[key])
    return scans


def run_one(
    name: str, settings: Settings, out: Path, progress: experiment.Progress | None = None
) -> tuple[str, dict[str, Any]]:
    """One run that never raises: whatever goes wrong becomes its status and reason."""
    try:
        refuse_existing(out, bool(settings.config["overwrite"]))
        experiment.clear(out)  # an earlier run's files must not stand for a run that never starts
    except (OSError, RbtmBenchError) as error:
        return name, {"status": "failed", "reason": experiment.reason(error, settings)}
    try:
        bench = own_workbench(settings)
        try:
            record = experiment.run(settings, out, progress, bench)
            _refuse_leftovers(settings, out)
            return name, record
        except BaseException:
            if bench is not None:
                bench.forget()
            raise
        finally:
            if bench is not None:
                bench.flush()
    except BaseException as error:  # of a plug-in's making: Ctrl-C does not reach a worker
        return name, ended_by(error, settings, out, experiment.trace_of(error))


def _refuse_leftovers(settings: Settings, out: Path) -> None:
    """Raise ``RunError`` if foreign plug-ins have left processes running, which are then ended."""
    foreign = foreign_modules(settings.config)
    left = end_left_processes() if foreign else 0
    if left:
        record = sweep_folder.record_of(out)
        write_json(out / "run.json", {**record, "status": "started"})
        processes = "a process" if left == 1 else f"{left} processes"
        names = foreign_plugins(settings.config, settings.choices)
        raise RunError(f"{names} left {processes} behind")


def undone(changed: Sequence[str], settings: Settings, out: Path) -> dict[str, Any]:
    """Leave a run during which files of others were changed as a failed one; its run.json."""
    others = f" (and {len(changed) - 1} more)" if changed[1:] else ""
    names = foreign_plugins(settings.config, settings.choices)
    error = RunError(f"{names}: {changed[0]}{others} was changed while it ran, and put back")
    with contextlib.suppress(OSError, RbtmBenchError):
        write_json(out / "run.json", {**sweep_folder.record_of(out), "status": "started"})
    return ended_by(error, settings, out)


def ended_by(
    error: BaseException, settings: Settings, out: Path, trace: str = ""
) -> dict[str, Any]:
    """Leave a run that ended by an error as a failed one; returns its run.json.

    Where even that cannot be written the run's own files make room; the answer says why anyway.
    """
    sweep_folder.clear_partial(out)
    record = sweep_folder.record_of(out)
    if record.get("status") in ("failed", "done"):  # its own ending
        return record
    ending = {
        "status": "failed",
        "reason": experiment.reason(error, settings),
        "finished": provenance.now(),
        "traceback": trace,
    }
    try:
        if record:
            write_json(out / "run.json", {**record, **ending})
        else:
            experiment.fail(settings, out, error)
    except (OSError, RbtmBenchError):
        with contextlib.suppress(OSError, RbtmBenchError):
            experiment.fail(settings, out, error)
    return {**record, **ending}
