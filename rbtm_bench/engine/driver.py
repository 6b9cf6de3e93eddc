"""The driver of comparisons and sweeps: a grid of runs, and a launcher that makes them.

The stages are the same for all: data checked, folder claimed, what is there kept, the rest
launched. A failed run is a row like any other.
"""

from __future__ import annotations

import contextlib
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rbtm_bench.core.files import make_folder
from rbtm_bench.core.process import settle
from rbtm_bench.engine import forecast, one_run, sweep_folder
from rbtm_bench.engine.crew import Supervisor
from rbtm_bench.engine.drive import make_crew
from rbtm_bench.engine.progress import Plan, RunBar, run_bar
from rbtm_bench.engine.sweep_folder import Asked
from rbtm_bench.runs.claim import refuse_existing
from rbtm_bench.runs.controls import Controls
from rbtm_bench.runs.grid import Point
from rbtm_bench.runs.settings import Settings


@dataclass
class Told:
    """What a launcher tells of runs that have ended. ``done`` says how, by name; ``idle`` are
    controls that there is nothing to run for, and why."""

    out: Path
    bar: RunBar
    done: dict[str, bool] = field(default_factory=dict)
    idle: dict[str, str] = field(default_factory=dict)

    @property
    def failed(self) -> bool:
        """Whether a run has."""
        return not all(self.done.values())

    def __call__(self, name: str, record: dict[str, Any]) -> None:
        """A run has ended, and this is its ``run.json``."""
        self.done[name] = record["status"] == "done"
        self.bar.ended(name, self.done[name], *sweep_folder.registrations(self.out / name))


@dataclass(frozen=True)
class Grid(ABC):
    """Runs to make, and what launches them.

    ``settings``: some in which every value occurs, the first point's first. ``notes``: lines on
    points that are one. ``workers``: how many runs go on at once, None where that is not known.
    ``controls``: what the grid adds by itself.
    """

    settings: list[Settings]
    notes: list[str]
    workers: int | None
    controls: Controls

    @property
    @abstractmethod
    def labels(self) -> dict[str, str] | None:
        """What to call every run, by the name of its folder; None where nobody knows them yet."""

    @abstractmethod
    def finished(self, out: Path) -> set[str]:
        """The names of the runs below ``out`` that stay as they are."""

    @abstractmethod
    def to_check(self, kept: set[str]) -> tuple[list[Point], list[Point] | str]:
        """Points whose data are opened first; all that are not ``kept``, or why nobody knows."""

    @abstractmethod
    def launch(
        self, kept: set[str], asked: Asked, crew: Sequence[Supervisor], told: Told
    ) -> str | None:
        """Make what is not ``kept``; returns what the launcher gave up by, if it did."""

    def folders(self, out: Path) -> list[Path]:
        """The run folders below ``out``, there or not."""
        names = self.labels
        return sweep_folder.run_folders(out) if names is None else [out / name for name in names]


@dataclass(frozen=True)
class Ended:
    """What became of a grid: its run folders, the names of failed runs, the labels of those that
    were not begun, how many were done before, and why the launcher gave up, if it did."""

    folders: list[Path]
    failed: list[str]
    left: list[str]
    reused: int
    broken: str | None


def drive(grid: Grid, asked: Asked, out: Path, resumed: bool) -> Ended:
    """Make the runs of a grid in the folder ``out``; ``resumed``: those that are missing.

    Raises ``ConfigError`` or ``DataError`` before anything is written if settings or data are at
    fault, or if the folder is taken.
    """
    overwrite = bool(grid.settings[0].config["overwrite"])
    if not resumed:
        refuse_existing(out, overwrite)
    for note in grid.notes:
        print(note, file=sys.stderr)
    kept = grid.finished(out) if resumed else set()
    total = None if grid.labels is None else len(grid.labels)
    with make_crew(grid.workers or 1, asked.command) as crew:
        most = "" if total == len(kept) else _check(grid, kept, crew[0])
        with claimed(asked, out, not resumed, overwrite):
            sweep_folder.clear(one for one in grid.folders(out) if one.name not in kept)
            seconds, added = _mean_seconds(out, kept), len(grid.controls.names)
            plan = Plan(total, len(kept), grid.workers, seconds, most, added)
            print(plan.opening(), file=sys.stderr)
            settle()
            with run_bar(plan) as bar:
                told = Told(out, bar)
                broken = grid.launch(kept, asked, crew, told)
    _merge_pairs(grid.settings[0], out)
    folders = grid.folders(out)
    begun = {one.name for one in folders if (one / "run.json").is_file()} | told.done.keys()
    failed = [n for n in begun if not told.done.get(n, sweep_folder.status(out / n) == "done")]
    left = [
        label for name, label in (grid.labels or {}).items() if name not in begun | told.idle.keys()
    ]
    return Ended(folders, failed, left, len(kept), broken)


def _merge_pairs(settings: Settings, out: Path) -> None:
    """Fold the stores that workers wrote one by one (pairs.store=per_worker) into one."""
    folder = Path(settings.config["pairs"]["folder"] or out / "pairs")
    if list(folder.glob("pairs-*")):
        from rbtm_bench.pairs.store import merge

        merge(folder)


def _mean_seconds(out: Path, names: set[str]) -> float | None:
    """What runs that are done took, on average; None if there are none."""
    taken = [sweep_folder.record_of(out / name).get("seconds") for name in names]
    known = [seconds for seconds in taken if isinstance(seconds, int | float)]
    return sum(known) / len(known) if known else None


def _check(grid: Grid, kept: set[str], supervisor: Supervisor) -> int | str:
    """Open the data in a child; the most registrations that the grid asks for, or why nobody
    knows."""
    points, rest = grid.to_check(kept)
    pin, serves = bool(grid.settings[0].config["pin"]), one_run.foreign_to(points)
    most: int | str = supervisor.call(forecast.check, points, rest, pin=pin, serves=serves)
    return most


@contextlib.contextmanager
def claimed(asked: Asked, out: Path, begin: bool, overwrite: bool) -> Iterator[None]:
    """The folder for this process alone, with what was asked for written into it. Ctrl-C says
    how to go on. With ``begin`` it must hold nothing yet: whoever was faster may have begun."""
    make_folder(out)
    with sweep_folder.at_work(out):
        if begin:
            refuse_existing(out, overwrite)
        asked.write(out)
        (out / sweep_folder.STOP).unlink(missing_ok=True)
        try:
            with sweep_folder.minding_ctrl_c():
                yield
        except KeyboardInterrupt:
            print(
                f"rbtm-bench: {sweep_folder.count_done(out)} finished runs stay; the rest: "
                f"{sweep_folder.resume_command(asked.kind, out)}",
                file=sys.stderr,
            )
            raise
