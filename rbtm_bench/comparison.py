"""Many runs side by side: each on a core of its own, a failed one is a row like any other."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

from rbtm_bench import experiment
from rbtm_bench.errors import RunError
from rbtm_bench.grid import Point

Tasks = dict[str, tuple[Any, Path]]
"""A point's name -> its settings and its folder."""

Done = Callable[[str, dict[str, Any]], None]
"""Called with a point's name and its ``run.json`` whenever a run has ended."""


def check_data(points: Sequence[Point]) -> None:
    """Open every data set once, before the first run, and see that the parts fit it.

    Raises ``DataError`` or ``ConfigError``: bad data common to all points stops here.
    """
    opened: dict[str, Any] = {}
    checked = set()
    for point in points:
        config = point.settings.config
        key = repr(sorted(config["dataset"].items()))
        if key not in opened:
            opened.clear()  # one data set in memory at a time
            opened[key] = experiment.build(config["dataset"])
        groups = ("backend", "guess", "similarity", "selector")
        fit = repr((key, [config[group] for group in groups]))
        if fit not in checked:
            checked.add(fit)
            experiment.check_fit(point.settings, opened[key])


def run_points(points: Sequence[Point], out: Path, jobs: int, done: Done) -> None:
    """Run the points into folders below ``out``, ``jobs`` at a time.

    Points that draw another run's gaps follow when all others have ended. If a worker process
    dies, the runs that had not ended start again, each in a process of its own, so that only
    the deadly one fails. With one job everything runs in this very process.
    """
    for late in (False, True):
        batch = [point for point in points if (point.gaps_of is not None) is late]
        tasks = {point.name: (_placed(point, out), out / point.name) for point in batch}
        for name, record in _results(tasks, jobs):
            del tasks[name]
            done(name, record)
        with ThreadPoolExecutor(jobs) as threads:
            for name, record in threads.map(run_alone, tasks, *zip(*tasks.values(), strict=True)):
                done(name, record)


def default_jobs() -> int:
    """The cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _placed(point: Point, out: Path) -> Any:
    """The point's settings with the folder of its gaps filled in, free to write into ``out``."""
    config = {**point.settings.config, "overwrite": True}
    if point.gaps_of is not None:
        config["selector"] = {**config["selector"], "gaps_from": str(out / point.gaps_of)}
    return replace(point.settings, config=config)


def _results(tasks: Tasks, jobs: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Names and records as runs end; stops early if a worker dies, without its whole batch."""
    if jobs == 1:
        for name, task in list(tasks.items()):
            yield run_one(name, *task)
        return
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    work = [delayed(run_one)(name, *task) for name, task in tasks.items()]
    parallel = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)
    with contextlib.suppress(TerminatedWorkerError):
        yield from parallel(work)


def run_one(name: str, settings: Any, out: Path) -> tuple[str, dict[str, Any]]:
    """One run that never raises: whatever goes wrong becomes its status and reason."""
    try:
        experiment.refuse_existing(out, bool(settings.config["overwrite"]))
        experiment.clear(out)  # an earlier run's files must not stand for a run that never starts
        return name, experiment.run(settings, out)
    except Exception as error:
        if not (out / "run.json").exists():
            experiment.fail(settings, out, error)
        return name, {"status": "failed", "reason": experiment.reason(error)}


def run_alone(name: str, settings: Any, out: Path) -> tuple[str, dict[str, Any]]:
    """``run_one`` in a process of its own; the death of that process is a failed run."""
    from joblib.externals.loky import ProcessPoolExecutor
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    with ProcessPoolExecutor(max_workers=1) as process:
        try:
            return process.submit(run_one, name, settings, out).result()
        except TerminatedWorkerError:
            error = RunError("the worker process died")
            experiment.fail(settings, out, error)
            return name, {"status": "failed", "reason": str(error)}
