"""One runner for all studies: runs, then what follows from them, then the page."""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path

import yaml

from rbtm_bench.core.files import make_folder, write_json, write_text
from rbtm_bench.engine import driver
from rbtm_bench.engine.comparison import Comparison
from rbtm_bench.engine.sweep_folder import Asked
from rbtm_bench.runs import controls
from rbtm_bench.runs.grid import Point
from rbtm_bench.studies import page
from rbtm_bench.studies.outcome import Outcome
from rbtm_bench.studies.plan import Plan
from rbtm_bench.studies.study_file import FILE, Study

SPENT = "spent.json"
"""Processor time of a study so far (s): of this process and of those that it waited for."""


def conduct(study: Study, asked: Asked, out: Path, jobs: int) -> Outcome:
    """Make what is missing of a study's runs in ``out``/runs, and its page; ``out`` keeps the study
    as a file, so that one that was cut goes on where it was.

    Raises ``ConfigError`` or ``DataError`` before the first run for settings or data at fault.
    """
    make_folder(out)
    before = _spent_before(out) - sum(os.times()[:4])
    plan = Plan.of(study)
    content = study.model_dump(exclude_defaults=True)
    write_text(out / FILE, yaml.safe_dump(content, sort_keys=False))
    try:
        outcome = _stages(plan, asked, out / "runs", jobs)
    finally:  # cut or not
        spent = before + sum(os.times()[:4])
        write_json(out / SPENT, {"seconds": spent})
    page.write(outcome, asked.command, spent, out)
    return outcome


def _stages(plan: Plan, asked: Asked, runs: Path, jobs: int) -> Outcome:
    """All runs: those that are known, those like them, rotations of the gaps of those chosen."""
    _make(list(plan.points.values()), asked, runs, jobs)
    _make(plan.follow(runs), asked, runs, jobs)
    sources = {way.like for way in plan.study.ways.values() if way.like}
    first = Outcome(plan, runs)
    chosen = {method: first.choice(method) for method in plan.methods(*map(str, sources))}
    _make(plan.rotate(chosen, runs), asked, runs, jobs)
    return Outcome(plan, runs)


def _spent_before(out: Path) -> float:
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        return float(json.loads((out / SPENT).read_text(encoding="utf-8"))["seconds"])
    return 0.0


class _Stage(Comparison):
    """A part of a study's runs."""

    def to_check(self, kept: set[str]) -> tuple[list[Point], list[Point] | str]:
        """One draw of every try: that its data can be read and fit."""
        rest = [point for point in self.points if point.name not in kept]
        firsts = {point.settings.identity.method: point for point in reversed(rest)}
        return list(firsts.values()), "one seed of each data set was opened"


def _make(points: Sequence[Point], asked: Asked, runs: Path, jobs: int) -> None:
    """A comparison of these points, in the folder that all of a study's share."""
    # a data set at a time is opened, and its registrations are shared while they are in memory
    ordered = sorted(points, key=lambda point: repr(point.settings.config["dataset"]))
    if not ordered:
        return
    settings = [point.settings for point in ordered]
    grid = _Stage(settings, [], jobs, controls.NONE, ordered)
    ended = driver.drive(grid, asked, runs, resumed=True)
    for name in ended.failed:
        print(f"failed: {name}", file=sys.stderr)
