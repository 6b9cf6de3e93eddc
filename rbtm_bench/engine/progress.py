"""How far things are, on standard error: a bar where somebody can see one."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from rbtm_bench.core import escape

LINE_S = 60.0
"""Least time between two lines that stand for a bar."""
UNTIL_DONE = "time unknown until the first run is done"


class Bar:
    """A bar of how far things are; does nothing when nobody is watching."""

    def __init__(self, rich_bar: Any = None, task: Any = None) -> None:
        self._bar, self._task = rich_bar, task
        self.visible = rich_bar is not None

    def update_to(self, done: float, total: int | None, note: str = "") -> None:
        """``done`` of ``total`` are ready."""
        if self._bar is not None:
            self._bar.update(self._task, completed=done, total=total, note=note)

    def step(self, note: str = "") -> None:
        """One more is ready."""
        if self._bar is not None:
            self._bar.update(self._task, advance=1, note=note)


@dataclass(frozen=True)
class Plan:
    """What is known of a sweep or comparison before its first run begins.

    ``total`` runs (None: nobody knows), ``reused`` of them done before, ``workers`` at a time
    (None: nobody knows); the seconds that a run took before, on average (None: none did); the most
    distinct registrations that the new ones ask for, or why nobody knows; how many are controls.
    """

    total: int | None
    reused: int = 0
    workers: int | None = 1
    run_seconds: float | None = None
    most: int | str = ""
    controls: int = 0

    def opening(self) -> str:
        """ "24 runs: 20 new, 4 done before; at most 960 distinct registrations; about 1:10"."""
        if self.total is None:
            return f"nobody knows how many runs: the sweeper makes them up; {UNTIL_DONE}"
        new = self.total - self.reused
        count = f"{self.total} run{'s' if self.total != 1 else ''}"
        count += f", {self.controls} of them controls" if self.controls else ""
        if not self.reused:
            words = [f"{count}, all new"]
        else:
            words = [f"{count}: {new} new, {self.reused} done before"]
        if not new:
            return words[0]
        if isinstance(self.most, str):
            words.append(f"number of distinct registrations unknown: {self.most}")
        else:
            words.append(f"at most {self.most} distinct registrations")
        left = self.seconds(new)
        words.append(UNTIL_DONE if left is None else f"about {clock_face(max(left, 1.0))}")
        return "; ".join(words)

    def seconds(self, runs: float) -> float | None:
        """What so many runs take if they are like those done before."""
        if self.run_seconds is None or self.workers is None:
            return None
        return runs * self.run_seconds / max(1.0, min(self.workers, runs))


def clock_face(seconds: float) -> str:
    """Seconds as 0:42 or 1:30:00."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


class RunBar:
    """The one bar of a sweep or comparison: runs done, reused and failed, which one is running,
    and the time left, once a run of this process is done. Any thread may report.

    Where nobody sees a bar it is a line on standard error when the first run is done, and then one
    every ``LINE_S`` at most.
    """

    def __init__(self, bar: Bar, plan: Plan, clock: Callable[[], float] = time.monotonic) -> None:
        self._bar, self._plan = bar, plan
        self._clock, self._began = clock, clock()
        self._lock = threading.Lock()
        self._parts: dict[str, float] = {}
        self._line_due = -math.inf
        self.done = self.failed = 0
        self._registrations = self._shared = 0.0
        self._show()

    def ended(self, name: str, done: bool, registrations: int = 0, shared: float = 0.0) -> None:
        """A run has ended; ``shared`` is the part of its registrations that it did not compute."""
        with self._lock:
            self._parts.pop(name, None)
            self.done, self.failed = self.done + done, self.failed + (not done)
            self._registrations += registrations
            self._shared += registrations * shared
            self._show()
            self._print_line()

    def began(self, name: str) -> None:
        """A run has begun; nobody may know how far it is."""
        with self._lock:
            if name not in self._parts:
                self._parts[name] = 0.0
                self._show()

    def part(self, name: str, scans: int, total: int) -> None:
        """A run that is not over has got through ``scans`` of ``total``."""
        with self._lock:
            self._parts[name] = min(scans / total, 1.0) if total else 0.0
            self._show()

    def text(self) -> str:
        """ "5 done, 3 reused, 1 failed, 62% of registrations shared, running a, 0:42 left"."""
        words = [f"{self.done} done"]
        words += [f"{self._plan.reused} reused"] if self._plan.reused else []
        words += [f"{self.failed} failed"] if self.failed else []
        if self._registrations:
            words.append(f"{self._shared / self._registrations:.0%} of registrations shared")
        if self._parts:
            others = len(self._parts) - 1
            words.append(
                f"running {next(iter(self._parts))}" + f" and {others} more" * (others > 0)
            )
        left = self._seconds_left()
        if left is not None:
            words.append(f"{clock_face(left)} left")
        return escape.terminal(", ".join(words))

    def _work(self) -> float:
        """Runs that this process has done, parts of runs included."""
        return self.done + self.failed + sum(self._parts.values())

    def _seconds_left(self) -> float | None:
        if self._plan.total is None:
            return None
        work = self._work()
        rest = max(self._plan.total - self._plan.reused - work, 0.0)
        if not self.done:
            return self._plan.seconds(rest)
        return rest * (self._clock() - self._began) / work

    def _show(self) -> None:
        self._bar.update_to(self._plan.reused + self._work(), self._plan.total, self.text())

    def _print_line(self) -> None:
        """Say how far it is where no bar does."""
        over = self._plan.reused + self.done + self.failed
        now = self._clock()
        if self._bar.visible or not self.done or over == self._plan.total or now < self._line_due:
            return
        self._line_due = now + LINE_S
        total = "" if self._plan.total is None else f" of {self._plan.total}"
        print(f"{over}{total} runs: {self.text()}", file=sys.stderr, flush=True)


@contextmanager
def bar(what: str, total: int | None = None) -> Iterator[Bar]:
    """A bar over ``total`` things called ``what``; it goes when it is done."""
    with _shown(_rich(time_left=True), what, total) as shown:
        yield shown


@contextmanager
def run_bar(plan: Plan) -> Iterator[RunBar]:
    """The bar of a sweep or comparison; it goes when it is done."""
    with _shown(_rich(time_left=False), "runs", plan.total) as shown:
        yield RunBar(shown, plan)


@contextmanager
def _shown(rich_bar: Any, what: str, total: int | None) -> Iterator[Bar]:
    if rich_bar is None:
        yield Bar()
        return
    with rich_bar:
        yield Bar(rich_bar, rich_bar.add_task(what, total=total, note=""))


def _rich(time_left: bool) -> Any:
    """Rich's progress display on standard error; None where nobody looks."""
    if sys.stderr is None or not sys.stderr.isatty():
        return None
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        *([TimeRemainingColumn()] if time_left else []),
        TextColumn("{task.fields[note]}", markup=False),
        console=Console(stderr=True),
        transient=True,
    )
