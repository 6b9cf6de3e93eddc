"""Many runs side by side: each on a core of its own, a failed one is a row like any other."""

from __future__ import annotations

import contextlib
import functools
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path
from typing import Any

from rbtm_bench.core.errors import RunError
from rbtm_bench.engine.crew import Supervisor
from rbtm_bench.runs.claim import refuse_existing
from rbtm_bench.runs.grid import Point
from rbtm_bench.runs.plugins import foreign_modules
from rbtm_bench.runs.settings import Settings

Done = Callable[[str, dict[str, Any]], None]
"""Called with a point's name and its ``run.json`` whenever a run has ended."""

Part = Callable[[str, int, int], None]
"""Called with a point's name, its scans done and its scans in all; from any thread."""


@contextlib.contextmanager
def make_crew(jobs: int, argv: Sequence[str] | None = None) -> Iterator[list[Supervisor]]:
    """``jobs`` supervisors, closed side by side at the end; killed if an exception passes."""
    crew = [Supervisor(argv=argv) for _ in range(jobs)]
    try:
        yield crew
    except BaseException:
        for supervisor in crew:
            supervisor.kill()
        raise
    finally:
        with ThreadPoolExecutor(jobs) as threads:
            list(threads.map(Supervisor.close, crew))


def run_points(
    points: Sequence[Point],
    out: Path,
    jobs: int,
    done: Done,
    *,
    fail_fast: bool = False,
    part: Part | None = None,
    crew: Sequence[Supervisor] | None = None,
) -> list[str]:
    """Run the points into folders below ``out``, ``jobs`` at a time, each in a child process.

    Points that draw another run's gaps follow when all others have ended. With ``fail_fast``
    none is started after the first failure; returns the names of those that were not. ``crew``
    are supervisors to use, which may have children already.
    """
    if crew is None:
        with make_crew(jobs) as own:
            return run_points(points, out, jobs, done, fail_fast=fail_fast, part=part, crew=own)
    stop = threading.Event()
    left: list[str] = []
    idle, lock = list(reversed(crew)), threading.Lock()

    def take(point: Point) -> Supervisor:
        """An idle one (there is one for every thread), if possible with the right child."""
        serves = foreign_modules(point.settings.config)
        with lock:
            right = [one for one in idle if one.serves == serves]
            idle.remove(supervisor := (right or idle)[-1])
            return supervisor

    def work(point: Point) -> tuple[str, dict[str, Any] | None]:
        if stop.is_set():
            return point.name, None
        supervisor = take(point)
        try:
            record = _supervised(supervisor, point, out, part)
        finally:
            idle.append(supervisor)
        if fail_fast and record["status"] != "done":
            stop.set()
        return point.name, record

    for late in (False, True):
        batch = [point for point in points if (point.gaps_of is not None) is late]
        with _threads(crew) as threads:
            for future in as_completed([threads.submit(work, point) for point in batch]):
                name, record = future.result()
                if record is None:
                    left.append(name)
                else:
                    done(name, record)
    return left


def run_alone(
    settings: Settings,
    out: Path,
    progress: Callable[[int, int], None] | None = None,
    argv: Sequence[str] | None = None,
) -> dict[str, Any]:
    """One run in a child of its own, which a limit of time or memory may end; its ``run.json``.

    ``argv``: the command that it notes down. Raises ``RunError`` if it fails, ``ConfigError`` or
    ``DataError`` before anything is written if settings or data are at fault.
    """
    from rbtm_bench.engine import one_run

    refuse_existing(out, bool(settings.config["overwrite"]))
    with Supervisor(argv=argv) as supervisor:
        points = [Point("run", settings)]
        serves = one_run.foreign_to(points)
        supervisor.call(one_run.check_data, points, pin=settings.config["pin"], serves=serves)
        record = supervisor.run(out.name, settings, out, progress)
    if record["status"] != "done":
        raise RunError(str(record["reason"]))
    return record


@contextlib.contextmanager
def _threads(crew: Sequence[Supervisor]) -> Iterator[ThreadPoolExecutor]:
    """A thread for every supervisor; an exception (Ctrl-C) kills the children, and so ends them."""
    with ThreadPoolExecutor(len(crew)) as threads:
        try:
            yield threads
        except BaseException:
            threads.shutdown(wait=False, cancel_futures=True)
            for supervisor in crew:
                supervisor.kill()
            raise


def _supervised(
    supervisor: Supervisor, point: Point, out: Path, part: Part | None
) -> dict[str, Any]:
    settings = placed(point, out)
    progress = functools.partial(part, point.name) if part else None
    return supervisor.run(point.name, settings, out / point.name, progress)


def default_jobs() -> int:
    """The cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def placed(point: Point, out: Path) -> Settings:
    """The point's settings with the folders of its gaps and of the pair store filled in, free to
    write into ``out``."""
    config = sharing(point.settings, out).config | {"overwrite": True}
    if point.gaps_of is not None:
        config["selector"] = {**config["selector"], "gaps_from": str(out / point.gaps_of)}
    return replace(point.settings, config=config)


def sharing(settings: Settings, out: Path) -> Settings:
    """Settings whose pair store, unless it has a folder, lies in the sweep's folder ``out``."""
    pairs = settings.config["pairs"]
    folder = pairs["folder"] or str((out / "pairs").resolve())
    return replace(settings, config={**settings.config, "pairs": {**pairs, "folder": folder}})
