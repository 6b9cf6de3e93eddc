"""The controls beside a grid's runs: what can be matched once rbtm's runs have ended, and is."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rbtm_bench.engine import drive, sweep_folder
from rbtm_bench.engine.crew import Supervisor
from rbtm_bench.engine.driver import Told
from rbtm_bench.runs.controls import Controls, resolve
from rbtm_bench.runs.grid import Point

UNMATCHED = "no run of rbtm that it could be matched to has ended well"


def finished(controls: Controls, points: Sequence[Point], out: Path) -> set[str]:
    """The names of the controls below ``out`` that stay as they are, beside ``points``."""
    resolved = resolve(controls.matched, [*points, *controls.plain], out)
    whole = {p.name for p in (*controls.plain, *resolved.points) if is_finished(p, out)}
    return whole | resolved.idle.keys()


def is_finished(point: Point, out: Path) -> bool:
    """Whether the point's folder holds what it gives."""
    return sweep_folder.is_finished(out / point.name, drive.placed(point, out))


def make(
    controls: Controls,
    points: Sequence[Point],
    kept: set[str],
    crew: Sequence[Supervisor],
    told: Told,
    fail_fast: bool,
) -> None:
    """Make the controls of a grid whose ``points`` have ended. After a failure with ``fail_fast``
    none is begun."""
    rest = [point for point in controls.plain if point.name not in kept]
    if rest and not (fail_fast and told.failed):
        run(rest, crew, told, fail_fast)
    if not controls.matched or (fail_fast and told.failed):
        return
    resolved = resolve(controls.matched, [*points, *controls.plain], told.out)
    told.idle |= resolved.idle
    known = resolved.idle.keys() | {point.name for point in resolved.points}
    told.idle |= {m.point.name: UNMATCHED for m in controls.matched if m.point.name not in known}
    for line in lines(told.idle):
        print(line, file=sys.stderr)
    sweep_folder.clear(told.out / name for name in told.idle)
    # the best run of rbtm may be another one than when the folder was looked at
    run([p for p in resolved.points if not is_finished(p, told.out)], crew, told, fail_fast)


def run(points: Sequence[Point], crew: Sequence[Supervisor], told: Told, fail_fast: bool) -> None:
    """Run points with the crew, and tell of them."""

    def done(name: str, record: dict[str, Any]) -> None:
        if record["status"] != "done":
            sweep_folder.tell_unwritten(told.out / name, record)
        told(name, record)

    part = told.bar.part
    drive.run_points(points, told.out, len(crew), done, fail_fast=fail_fast, part=part, crew=crew)


def lines(idle: dict[str, str]) -> list[str]:
    """Controls that are not run, by the reason."""
    by_reason: dict[str, list[str]] = {}
    for name, why in idle.items():
        by_reason.setdefault(why, []).append(name)
    return [
        f"no control {names[0]}{f' (and {len(names) - 1} more)' if names[1:] else ''}: {why}"
        for why, names in by_reason.items()
    ]
